"""A picture taken back to where it was: shift, turn and scale about its middle, and circles that
have grown alike. Done to ellipses, it holds whatever lens and pane are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array, Ellipses


@dataclass(frozen=True, eq=False)
class ImageTransform:
    """By how much a picture is shifted, `shift` (2,) px, turned (from u to v, rad) and larger
    (`scale`) about its `middle` (2,) px, and by how much radii are `grown` px beside that."""

    middle: Array
    shift: Array
    turn: float
    scale: float
    grown: float

    def undone(self, uv: Array) -> Array:
        """Where places (n, 2) px were before."""
        cos = math.cos(self.turn)
        sin = math.sin(self.turn)
        away = (uv - self.middle - self.shift) / (1 + self.scale)
        return self.middle + away @ np.array([[cos, -sin], [sin, cos]])

    def undone_ellipses(self, ellipses: Ellipses, at: Array) -> Ellipses:
        """What the ellipses with the numbers `at` were before."""
        axes = (ellipses.semi_axes_px[at] - self.grown) / (1 + self.scale)
        dark = ellipses.darkness
        return Ellipses(
            self.undone(ellipses.center_px[at]),
            np.maximum(axes, 1e-3),
            ellipses.angle[at] - self.turn,
            ellipses.cov[at],
            ellipses.status[at],
            None if dark is None else dark[at],
        )


UNCHANGED = ImageTransform(np.zeros(2), np.zeros(2), 0.0, 0.0, 0.0)
