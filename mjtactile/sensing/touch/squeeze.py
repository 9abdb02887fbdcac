"""Object size from a squeeze between two fingers (or against a wall), from sensing alone.

The membranes deform too, but the cameras measure their deformation. The object's width starts from
the opening between the two sensors' frames. The height of each membrane over its frame at the
contact is subtracted (docs/theory/exploration.md, Eq. P1). No model of membrane or gas is
needed.
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
    """History of a squeeze with T samples; all arrays are (T,).

    `time` is in s. `opening`, m, is between the sensors' frames. For one sensor it is from its
    frame to the wall behind the object. `force`, N, with `force_sd`, is the mean over the fingers.
    `width`, m, with `width_sd`, is that of the object (NaN without contact). `area`, m^2, is the
    contact area (mean over the fingers).
    """

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
        """Create the history from the touches of one or two sensors, cycle by cycle, and the
        opening."""
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
    """Return the width of the held object and its standard deviation, m.

    Both are NaN if a sensor has no contact. Two sensors face each other, y up: x of the second is
    -x of the first. Faces that are not parallel to the frames touch at different positions. Their
    planes are extrapolated to the point halfway, and the width is measured there. A face that
    touches with an edge only appears less tilted than it is. So a fraction of the extrapolation is
    added to the uncertainty. For more than two sensors around the object, the width follows from
    the faces. It is twice their mean distance from the center.
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
    """Return the height and slope of the object's face; None without contact. The results are the
    height of the membrane at the contact's centroid, m, and the centroid (2,), m. The last is the
    slope (2,) there. A paraboloid is fitted to the surface inside the contact. So the height of a
    curved face is that of its nearest point. It does not fall as the contact grows."""
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
    """Return the area covered by the contact, m^2; 0 without contact. It is the area of the convex
    hull. A face has its highest pressure along its edges. So a patch derived from pressure has
    holes."""
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
    midpoint = np.column_stack([grid[0][columns], grid[1][rows]])
    corners = np.concatenate(
        [midpoint + half * sign for sign in ((-1, -1), (-1, 1), (1, -1), (1, 1))]
    )
    return max(contact.area, float(ConvexHull(corners).volume))
