"""Deviation of an explored surface from ground truth, available only in simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mjtactile.core.types import Array
from mjtactile.explore.exploration import ExplorationResult
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.object_size import principal_sizes
from mjtactile.sim.true_surface import TrueSurface

_FACETS = 5e-5  # reduction of a size by flat triangles, m
_TOUCHED_SD = 3e-5  # error of the triangulation itself, m
_APART = 2e-3  # distance to the nearest vertex above which the plane is not used, m


def score(found: ExplorationResult, true: TrueSurface, p_HO: Array, R_HO: Array) -> dict[str, Any]:
    """Compare with ground truth.

    Args:
        found: Explored surface.
        true: Surface of the object.
        p_HO: (3,) True position of the object in the holder, m.
        R_HO: (3, 3) True rotation of the object in the holder.

    Returns:
        `surface_error_mm_true` (root mean square of the distances from either surface to the
        other), `surface_error_95_mm_true` (95 % quantile), `size_error_true` (largest relative
        error of three extents along the object's axes), `within_1_sd_true`, `within_2_sd_true`
        (fractions of the estimated surface), `sizes_within_true` (fraction of the three estimated
        sizes whose 68 % interval contains the true one), `sizes_within_2_sd_true`.
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
    """Return the fraction of sizes within their intervals, and within twice their sd. The sizes are
    along the estimated axes. A tolerance of 0.05 mm covers the triangulation error."""
    _, axes = principal_sizes(found.mesh)
    true = surface.extents(R_HO.T @ axes)
    low, high = found.sizes.interval.T
    twice = np.abs(true - found.sizes.mean) <= 2 * found.sizes.sd + _FACETS
    return {
        "sizes_within_true": float(np.mean((true >= low - _FACETS) & (true <= high + _FACETS))),
        "sizes_within_2_sd_true": float(np.mean(twice)),
    }


def _missed(mesh: Mesh, points: Array) -> Array:
    """Return the distances of true points from the estimated surface, (N,) m. The distance is to
    the plane of the nearest vertex, or to that vertex if it is far away."""
    way, nearest = cKDTree(mesh.vertices).query(points)
    across = np.einsum("ni,ni->n", points - mesh.vertices[nearest], mesh.normals[nearest])
    return np.where(way < _APART, across, way)
