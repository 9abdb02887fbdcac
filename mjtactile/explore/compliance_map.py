"""Local compliance of an explored object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.surface_patch import Patch

_RADIUS = 8e-3  # range of influence of a touch, m
_SIGNIFICANT = 2.0  # sd


@dataclass(frozen=True, eq=False)
class ComplianceMap:
    """Compliance, m/N, of each vertex (V,), and mean of all touches with its sd."""

    by_vertex: Array
    mean: float
    mean_sd: float

    @classmethod
    def of(cls, patches: Sequence[Patch], mesh: Mesh) -> ComplianceMap:
        """Interpolate the compliance from touches: local value near a touch, mean far from all."""
        known = [patch for patch in patches if math.isfinite(patch.compliance)]
        if not known:
            return cls(np.full(len(mesh.vertices), math.nan), math.nan, math.nan)
        values = np.array([patch.compliance for patch in known])
        weights = np.array([patch.compliance_sd**-2 for patch in known])
        mean = float(np.average(values, weights=weights))
        centers = np.stack([patch.center for patch in known])
        distance = np.linalg.norm(mesh.vertices[:, None] - centers[None], axis=2)
        near = np.exp(-0.5 * (distance / _RADIUS) ** 2) * weights
        far = 1e-3 * weights.sum()
        by_vertex = (near @ values + far * mean) / (near.sum(axis=1) + far)
        return cls(np.maximum(by_vertex, 0.0), mean, float(weights.sum() ** -0.5))

    def summary(self) -> dict[str, Any]:
        """Return `stiffness_N_m`, or a lower bound `stiffness_min_N_m` if it is unknown."""
        if not math.isfinite(self.mean):
            return {"stiffness_N_m": math.nan, "stiffness_min_N_m": math.nan}
        if self.mean > _SIGNIFICANT * self.mean_sd:
            return {"stiffness_N_m": 1 / self.mean, "stiffness_min_N_m": math.nan}
        minimum = 1 / (max(self.mean, 0.0) + _SIGNIFICANT * self.mean_sd)
        return {"stiffness_N_m": math.nan, "stiffness_min_N_m": minimum}
