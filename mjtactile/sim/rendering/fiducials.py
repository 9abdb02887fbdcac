"""Fiducials in the camera image: white ground and black circles that never move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.fiducials import Fiducials
from mjtactile.core.types import Array

_INWARD = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class FiducialRenderer:
    """Discs `p_SF`, `n_S` (F, 3) of a `radius` m on white ground.

    The ground extends `ground` m around each disc, or covers the area between the outlines `white`
    (outer, inner), (n, 3) m each. `blur_px` is the minimum blur of their image.
    """

    p_SF: Array
    n_S: Array
    radius: float
    ground: float
    white: tuple[Array, Array] | None
    blur_px: float

    @classmethod
    def of(cls, design: SensorDesign) -> FiducialRenderer | None:
        """Create the renderer of `design`; None without fiducials."""
        fiducials = design.fiducials
        if fiducials is None:
            return None
        p_SF = fiducials.p_SF(design)
        n_S = np.broadcast_to(_INWARD, p_SF.shape)
        on_rim = fiducials.surface == "rim"
        white = _lip(design, fiducials) if on_rim else None
        blur = 0.0 if on_rim else fiducials.blur_px
        return cls(p_SF, n_S, fiducials.radius, fiducials.ground, white, blur)


def _lip(design: SensorDesign, fiducials: Fiducials) -> tuple[Array, Array]:
    """Return the outlines of the lip's inner face: the walls behind it, and the opening."""
    outline = design.frame.outline
    if outline is not None:
        at = (fiducials.step, 0.0)
        lip = [np.pad(outline.around(by), ((0, 0), (0, 1))) for by in at]
        outside, opening = (edge - [0.0, 0.0, fiducials.lip] for edge in lip)
        return outside, opening
    half = np.array([design.frame.length, design.frame.width]) / 2
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    height = np.full((4, 1), -fiducials.lip)
    outer = np.hstack([corners * (half + fiducials.step), height])
    inner = np.hstack([corners * half, height])
    return outer, inner
