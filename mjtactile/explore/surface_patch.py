"""`Patch`: surface information from one touch, in the object's own frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array


@dataclass(frozen=True, eq=False)
class Patch:
    """Surface points from one touch, frame H (the holder's, in which the object is fixed).

    Attributes:
        points: (N, 3) Points on the surface, m.
        free: (M, 3) Points of the membrane without contact, outside the object, m.
        normal: (3,) Outward normal of the patch.
        kind: Kind of contact (`ContactShape.kind`); "unknown": the points are membrane heights.
        force: Contact force of the points, N.
        compliance: Compliance of the object at the touch, m/N; NaN: unknown.
        compliance_sd: Its standard deviation, m/N.
        spread: (4,) Standard deviations: of the patch as a whole, m; of its tilt, rad; of its
            curvature, 1/m; of each single point, m.
        group: Group number of the patches of one grip; 0: no group.
        loose: Standard deviation of a displacement common to all patches of the group, m.
    """

    points: Array
    free: Array
    normal: Array
    kind: str
    force: float
    compliance: float = math.nan
    compliance_sd: float = math.nan
    spread: tuple[float, float, float, float] = (5e-5, 5e-3, 5.0, 2e-5)
    group: int = 0
    loose: float = 0.0

    @property
    def center(self) -> Array:
        """Mean (3,), m, of its points."""
        return self.points.mean(axis=0)

    def covariance(self) -> Array:
        """Return the covariance of the points along the normal, (N, N) m^2. The points lie on one
        face with uncertain height, tilt and curvatures."""
        axes = tangents(self.normal)
        u, v = axes @ (self.points - self.center).T
        height, tilt, curvature, alone = self.spread
        bent = [curvature * u * u / 2, curvature * u * v, curvature * v * v / 2]
        rows = np.stack([np.full_like(u, height), tilt * u, tilt * v, *bent])
        return rows.T @ rows + alone**2 * np.eye(len(u))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a file; lengths in m."""
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Patch:
        """Convert a table back to a patch; the inverse of `to_dict`. None represents an unknown
        value."""
        height, tilt, curvature, alone = values["spread"]
        return cls(
            np.reshape(np.array(values["points"], float), (-1, 3)),
            np.reshape(np.array(values["free"], float), (-1, 3)),
            np.array(values["normal"], float),
            str(values["kind"]),
            float(values["force"]),
            _nan_if_none(values["compliance"]),
            _nan_if_none(values["compliance_sd"]),
            (height, tilt, curvature, alone),
            int(values.get("group", 0)),
            float(values.get("loose", 0.0)),
        )


def _nan_if_none(value: float | None) -> float:
    return math.nan if value is None else float(value)


def tangents(normal: Array) -> Array:
    """Return two unit vectors (2, 3) normal to a unit vector and to each other."""
    minimum = int(np.argmin(np.abs(normal)))
    first = np.cross(normal, np.eye(3)[minimum])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def group_covariance(patch: Patch, other: Patch) -> Array:
    """Return the covariance (N, M), m^2, of two patches' points along their normals. It is caused
    by the common displacement of the object in a grip."""
    if not patch.group or patch.group != other.group:
        return np.zeros((len(patch.points), len(other.points)))
    alike = patch.loose * other.loose * float(patch.normal @ other.normal)
    return np.full((len(patch.points), len(other.points)), alike)
