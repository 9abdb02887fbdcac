"""What a squeeze between two fingers (or a press against a wall) says of the object's own size,
from sensing alone.

The membranes give way too, but the cameras see by how much: the object's width is the opening
between the two sensors' frames less the height at which each membrane stands over its frame where
it touches (docs/theory/exploration.md, Eq. P1). No model of membrane or gas enters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array, Touch
from mjtactile.sensing.settings import DEFAULTS, SqueezeSettings


@dataclass(frozen=True, eq=False)
class Squeeze:
    """A history of T samples: `time` s, `opening` m between the sensors' frames (of one sensor:
    from its frame to the wall behind the object), `force` N (mean over the fingers) with
    `force_sd`, `width` m of the object (NaN where nothing touches) with `width_sd`, `area` m^2 of
    the contact (mean over the fingers), all (T,)."""

    time: Array
    opening: Array
    force: Array
    force_sd: Array
    width: Array
    width_sd: Array
    area: Array

    def __post_init__(self) -> None:
        n = len(np.asarray(self.time))
        for name in self.__dataclass_fields__:
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != (n,):
                raise InputError(
                    f"shape {value.shape} does not match ({n},)", source="Squeeze", field=name
                )
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.time)

    @classmethod
    def of(
        cls,
        touches: Sequence[Sequence[Touch]],
        openings: Sequence[float],
        s: SqueezeSettings = DEFAULTS.squeeze,
    ) -> Squeeze:
        """From what one or two sensors said, cycle by cycle, and the opening."""
        rows = [
            _sample(touch, opening, s) for touch, opening in zip(touches, openings, strict=True)
        ]
        return cls(*np.array(rows).reshape(-1, 7).T)


def _sample(touch: Sequence[Touch], opening: float, s: SqueezeSettings) -> tuple[float, ...]:
    forces = [t.force_normal for t in touch]
    sds = [t.force_normal_sd for t in touch]
    area = float(np.mean([covered_area(t) for t in touch]))
    width = object_width(touch, opening, s)
    return (
        touch[0].time,
        opening,
        float(np.mean(forces)),
        math.hypot(*sds) / len(sds),
        *width,
        area,
    )


def object_width(
    touch: Sequence[Touch], opening: float, s: SqueezeSettings = DEFAULTS.squeeze
) -> tuple[float, float]:
    """Width and its sd, m, of what the sensors hold; NaN when one of them does not touch.

    Two sensors face each other, y up: x of the second is -x of the first. Faces that are not
    parallel to the frames touch at different places; their planes are carried on to the point
    halfway, and the width is measured there. A face that touches with an edge only looks less
    tilted than it is, so that this is uncertain by a share of what it adds. Of more than two, which
    stand around the object, it is twice the mean distance of the faces from the middle.
    """
    faces = [contact_face(t, s) for t in touch]
    if any(face is None for face in faces):
        return math.nan, math.nan
    z, at, slope = (np.array([face[k] for face in faces if face is not None]) for k in range(3))
    if len(faces) > 2:
        return opening - 2 * float(z.mean()), s.width_sd
    mirror = np.array([[1.0, 1.0], [-1.0, 1.0]])[: len(faces)]
    # all in the axes of the first
    at = at * mirror
    slope = slope * mirror
    carried = np.sum(slope * (at.mean(axis=0) - at), axis=1)
    return opening - float((z + carried).sum()), math.hypot(
        s.width_sd, s.tilt_fraction * float(np.abs(carried).sum())
    )


def contact_face(
    touch: Touch, s: SqueezeSettings = DEFAULTS.squeeze
) -> tuple[float, Array, Array] | None:
    """Where the object's face is: height, m, of the membrane at the contact's centroid (2,) m, and
    its slope (2,) there; None when nothing touches.

    A paraboloid is fitted to the surface inside the contact, so that the height of a curved face is
    that of its nearest point and does not fall as the contact grows.
    """
    surface = touch.surface
    contact = touch.contact
    if (
        not touch.touching
        or surface is None
        or contact is None
        or not np.isfinite(contact.centroid).all()
    ):
        return None
    radius = min(
        max(s.patch_fraction * math.sqrt(contact.area / math.pi), s.patch_radius[0]),
        s.patch_radius[1],
    )
    x, y = (a - c for a, c in zip(np.meshgrid(surface.x, surface.y), contact.centroid, strict=True))
    weight = np.clip(1 - (x**2 + y**2) / radius**2, 0.0, None)
    inside = weight > 0
    if inside.sum() < s.nodes_min:
        return None
    x = x[inside] / radius
    y = y[inside] / radius
    w = np.sqrt(weight[inside])
    columns = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    fit = np.linalg.lstsq(columns * w[:, None], surface.z[inside] * w, rcond=None)[0]
    return float(fit[0]), contact.centroid, fit[1:3] / radius


def covered_area(touch: Touch) -> float:
    """Area, m^2, that the contact covers: its convex hull, since a face presses hardest along its
    edges and a patch drawn from pressure has holes; 0 when nothing touches."""
    contact = touch.contact
    traction = touch.traction
    surface = touch.surface
    if contact is None or not contact.mask.any():
        return 0.0
    grids = [(grid.x, grid.y) for grid in (traction, surface) if grid is not None]
    grid = next(((x, y) for x, y in grids if contact.mask.shape == (len(y), len(x))), None)
    if grid is None:
        return contact.area
    rows, columns = np.nonzero(contact.mask)
    half = np.array([grid[0][1] - grid[0][0], grid[1][1] - grid[1][0]]) / 2
    middle = np.column_stack([grid[0][columns], grid[1][rows]])
    corners = np.concatenate(
        [middle + half * sign for sign in ((-1, -1), (-1, 1), (1, -1), (1, 1))]
    )
    return max(contact.area, float(ConvexHull(corners).volume))
