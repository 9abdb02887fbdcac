"""Triangle mesh of an estimated surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.surface_posterior import SurfacePosterior

_MARGIN = 4e-3  # margin around the estimated surface, m
_ACROSS = 90  # maximum number of triangles along the longest side
_SLOPE_STEP = 5e-5  # step of the numerical gradient, m


def mesh_of(surface: SurfacePosterior, edge: float = 1e-3) -> Mesh:
    """Triangulate a surface. The `edge` of a triangle, m, is longer if the object spans more than
    ninety edges. Raises InputError if manifold3d is not installed."""
    try:
        from manifold3d import Manifold
    except ImportError as error:
        raise InputError(
            "needs manifold3d: pip install 'mjtactile[explore]'", source="explore"
        ) from error
    low, high = _box(surface)
    edge = max(edge, float((high - low).max()) / _ACROSS)
    counts = np.ceil((high - low) / edge).astype(int) + 1
    axes = [low[k] + edge * np.arange(counts[k]) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = surface.distance(grid)
    inside = _depth_function(outside.tolist(), counts.tolist(), low.tolist(), edge)
    bounds = [*(low + edge), *(high - edge)]
    found = Manifold.level_set(inside, bounds, edge).to_mesh()
    return with_uncertainty(surface, np.array(found.vert_properties[:, :3], float), found.tri_verts)


def _depth_function(
    outside: list[float], counts: list[int], low: list[float], edge: float
) -> Callable[[float, float, float], float]:
    """Return a function for the depth inside the surface, interpolated between grid nodes. It uses
    plain Python numbers, since it is called about a hundred thousand times for single points."""
    nx, ny, nz = (count - 2 for count in counts)
    row = counts[2]
    plane = counts[1] * counts[2]
    x0, y0, z0 = low
    per = 1 / edge

    def along_yz(at: int, v: float, w: float) -> float:
        """Interpolate between the four nodes of a cell's side, from node `at` on."""
        here = (1 - w) * outside[at] + w * outside[at + 1]
        next_row = (1 - w) * outside[at + row] + w * outside[at + row + 1]
        return (1 - v) * here + v * next_row

    def inside(x: float, y: float, z: float) -> float:
        # in cells
        u = (x - x0) * per
        v = (y - y0) * per
        w = (z - z0) * per
        i = min(max(int(u), 0), nx)
        j = min(max(int(v), 0), ny)
        k = min(max(int(w), 0), nz)
        at = i * plane + j * row + k
        near = along_yz(at, v - j, w - k)
        far = along_yz(at + plane, v - j, w - k)
        return -((1 - (u - i)) * near + (u - i) * far)

    return inside


def with_uncertainty(surface: SurfacePosterior, vertices: Array, triangles: Array) -> Mesh:
    """Return a mesh with its normals and standard deviations."""
    change = [
        surface.distance(vertices + step) - surface.distance(vertices - step)
        for step in _SLOPE_STEP * np.eye(3)
    ]
    slope = np.stack(change, axis=1) / (2 * _SLOPE_STEP)
    length = np.linalg.norm(slope, axis=1)
    steep = np.maximum(length, 0.2)
    normals = slope / np.maximum(length, 1e-9)[:, None]
    sd = surface.distance_sd(vertices) / steep
    return Mesh(vertices, np.asarray(triangles, int), normals, sd)


def _box(surface: SurfacePosterior) -> tuple[Array, Array]:
    """Return the lower and upper corner, m, of a box around the surface."""
    extent = 1e-3 * float(np.linalg.norm(np.exp(surface.theta[6:9])))
    center = 1e-3 * surface.theta[:3]
    coarse = np.linspace(-1.2 * extent, 1.2 * extent, 33)
    grid = np.stack(np.meshgrid(coarse, coarse, coarse, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = grid[surface.distance(center + grid) < 0] + center
    if not len(inside):
        inside = center[None]
    step = coarse[1] - coarse[0]
    return inside.min(axis=0) - step - _MARGIN, inside.max(axis=0) + step + _MARGIN
