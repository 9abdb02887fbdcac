"""How far an explored surface is from the true one, which only a simulation knows."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mjtactile.core.types import Array
from mjtactile.explore.exploration import ExplorationResult
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.object_size import principal_sizes
from mjtactile.sim.true_surface import TrueSurface

_FACETS = 5e-5  # m, that a triangle's edge takes off a size
_TOUCHED_SD = 3e-5  # m, that the triangles are off by themselves
_APART = (
    2e-3  # m: a true point that is farther than this from all vertices is not beside the surface
)


def score(found: ExplorationResult, true: TrueSurface, p_HO: Array, R_HO: Array) -> dict[str, Any]:
    """Compare with the truth.

    Args:
        found: What was explored.
        true: The object's surface.
        p_HO: (3,) m, where the object truly is in the holder.
        R_HO: (3, 3) how it truly lies there.

    Returns:
        `surface_error_mm_true` (root mean square of distances from either surface to the other),
        `surface_error_worst_mm_true` (95 % are below), `size_error_true` (of three extents along
        the object's axes, the worst share), `within_1_sd_true`, `within_2_sd_true`
        (share of the believed surface), `sizes_within_true` (share of the three believed sizes
        whose 68 % interval has the true one), `sizes_within_2_sd_true`.
    """
    mesh = found.mesh
    vertices = (mesh.vertices - p_HO) @ R_HO
    normals = mesh.normals @ R_HO
    weights = mesh.areas()
    outside = true.off(vertices, normals)
    missed = _missed(Mesh(vertices, mesh.triangles, normals, mesh.sd), true.points)
    square = (np.average(outside**2, weights=weights) + float(np.mean(missed**2))) / 2
    sizes = np.ptp(vertices, axis=0) / true.extents(np.eye(3))
    sd = np.maximum(mesh.sd, _TOUCHED_SD)
    both = np.concatenate([np.abs(outside), np.abs(missed)])
    return {
        "surface_error_mm_true": 1e3 * float(np.sqrt(square)),
        "surface_error_95_mm_true": 1e3 * float(np.quantile(both, 0.95)),
        "size_error_true": float(np.abs(sizes - 1).max()),
        "within_1_sd_true": float(np.average(np.abs(outside) < sd, weights=weights)),
        "within_2_sd_true": float(np.average(np.abs(outside) < 2 * sd, weights=weights)),
        **_sizes_within(found, true, R_HO),
    }


def _sizes_within(found: ExplorationResult, surface: TrueSurface, R_HO: Array) -> dict[str, float]:
    """Share of the sizes along the believed axes that are within their intervals, and within twice
    their sd; one that is known to less than the triangles' own 0.05 mm is given these."""
    _, axes = principal_sizes(found.mesh)
    true = surface.extents(R_HO.T @ axes)
    low, high = found.sizes.interval.T
    twice = np.abs(true - found.sizes.mean) <= 2 * found.sizes.sd + _FACETS
    return {
        "sizes_within_true": float(np.mean((true >= low - _FACETS) & (true <= high + _FACETS))),
        "sizes_within_2_sd_true": float(np.mean(twice)),
    }


def _missed(mesh: Mesh, points: Array) -> Array:
    """How far true points are from the believed surface, (N,) m: from the plane of its nearest
    vertex, or from that vertex where they are not beside it."""
    way, nearest = cKDTree(mesh.vertices).query(points)
    across = np.einsum("ni,ni->n", points - mesh.vertices[nearest], mesh.normals[nearest])
    return np.where(way < _APART, across, way)
