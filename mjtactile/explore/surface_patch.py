"""`Patch`: what one touch says of an object's surface, in the object's own frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array

_KEPT = (
    "points",
    "free",
    "normal",
    "kind",
    "force",
    "compliance",
    "compliance_sd",
    "spread",
    "group",
    "loose",
)


@dataclass(frozen=True, eq=False)
class Patch:
    """Points of a surface that one touch found, frame H (the holder's, in which the object rests).

    Attributes:
        points: (N, 3) m, on the surface.
        free: (M, 3) m, where the sheet was and touched nothing: outside of the object.
        normal: (3,) outward, of the patch.
        kind: What touched (`ContactShape.kind`); "unknown": points are the sheet's own heights.
        force: N, at which the points were seen.
        compliance: m/N by which the object gave way under the touch; NaN: unknown.
        compliance_sd: m/N.
        spread: (4,) sd of the patch as one, m; of its tilt, rad; of its curvature, 1/m; of each
            point alone, m.
        group: Patches of one grip have the same; 0: none of them.
        loose: m, sd of a shift that all patches of the group have in common.
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
    def middle(self) -> Array:
        """(3,) m, of its points."""
        return self.points.mean(axis=0)

    def covariance(self) -> Array:
        """Of its points along the normal, (N, N) m^2: they lie on one face whose height, tilt and
        curvatures are not known exactly."""
        axes = tangents(self.normal)
        u, v = axes @ (self.points - self.middle).T
        height, tilt, curvature, alone = self.spread
        rows = np.stack(
            [
                np.full_like(u, height),
                tilt * u,
                tilt * v,
                curvature * u * u / 2,
                curvature * u * v,
                curvature * v * v / 2,
            ]
        )
        return rows.T @ rows + alone**2 * np.eye(len(u))

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for a file; lengths m."""
        return {
            name: value.tolist() if isinstance(value := getattr(self, name), np.ndarray) else value
            for name in _KEPT
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Patch:
        """The inverse of `to_dict`; None stands for a number that is not known."""
        height, tilt, curvature, alone = values["spread"]
        return cls(
            np.reshape(np.array(values["points"], float), (-1, 3)),
            np.reshape(np.array(values["free"], float), (-1, 3)),
            np.array(values["normal"], float),
            str(values["kind"]),
            float(values["force"]),
            _known(values["compliance"]),
            _known(values["compliance_sd"]),
            (height, tilt, curvature, alone),
            int(values.get("group", 0)),
            float(values.get("loose", 0.0)),
        )


def _known(value: float | None) -> float:
    return math.nan if value is None else float(value)


def tangents(normal: Array) -> Array:
    """Two unit vectors (2, 3) across a unit vector, and each other."""
    least = int(np.argmin(np.abs(normal)))
    first = np.cross(normal, np.eye(3)[least])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def between(patch: Patch, other: Patch) -> Array:
    """Covariance (N, M) m^2 of two patches' points along their normals, by what their grip did to
    both."""
    if not patch.group or patch.group != other.group:
        return np.zeros((len(patch.points), len(other.points)))
    alike = patch.loose * other.loose * float(patch.normal @ other.normal)
    return np.full((len(patch.points), len(other.points)), alike)
