"""Inverse of an image transform: shift, rotation and scale about the image center, and a common
change of radius. Applied to ellipses, it is valid for any lens and glass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array, Ellipses


@dataclass(frozen=True, eq=False)
class ImageTransform:
    """Image transform about `middle` (2,), px: `shift` (2,), px, rotation `turn` (from u to v),
    rad, and relative enlargement `scale`. Radii grow by `grown` px in addition."""

    middle: Array
    shift: Array
    turn: float
    scale: float
    grown: float

    def undone(self, uv: Array) -> Array:
        """Return the positions (n, 2), px, before the transform."""
        cos = math.cos(self.turn)
        sin = math.sin(self.turn)
        away = (uv - self.middle - self.shift) / (1 + self.scale)
        return self.middle + away @ np.array([[cos, -sin], [sin, cos]])

    def undone_ellipses(self, ellipses: Ellipses, at: Array) -> Ellipses:
        """Return the ellipses with indices `at` before the transform."""
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
