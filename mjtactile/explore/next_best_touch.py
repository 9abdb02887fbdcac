"""Next touch: the reachable point where the surface is most uncertain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from mjtactile.core.types import Array
from mjtactile.explore.surface_patch import Patch, tangents

_RADIUS = 5e-3  # radius of a touch, m
_BENT = 6.0  # power of the mean normal's length: 0.1 on a right angle's edge
_NEAR = 4e-3  # distance from a patch below which a touch has little value, m


@dataclass(frozen=True, eq=False)
class Aim:
    """Target point `p_H` (3,), m, and the estimated outward normal `n_H` at it."""

    p_H: Array
    n_H: Array

    def R_SH(self) -> Array:
        """Return the rotation (3, 3) of the holder so that the normal points at the sensor."""
        u, v = tangents(self.n_H)
        return np.stack([u, -v, -self.n_H])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Estimated surface as triangles. `vertices` (V, 3), m, `triangles` (T, 3), outward `normals`
    (V, 3), and `sd` (V,) of each vertex along its normal, m."""

    vertices: Array
    triangles: Array
    normals: Array
    sd: Array

    def areas(self) -> Array:
        """Return the areas (V,), m^2: a third of each triangle's for each of its vertices."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
        return np.bincount(self.triangles.ravel(), np.repeat(third, 3), len(self.vertices))

    def error(self) -> float:
        """Return the root mean square of the sd over the surface, m."""
        return float(np.sqrt(np.average(self.sd**2, weights=self.areas())))


def _mean_around(mesh: Mesh, values: Array) -> Array:
    """Return the value of a touch at each vertex, m. This is the mean of `values` (V,) over the
    area of a touch. It is reduced on curved areas, since an edge or a corner gives information only
    about itself."""
    near = KDTree(mesh.vertices).query_ball_point(mesh.vertices, _RADIUS)
    areas = mesh.areas()
    worth = np.empty(len(near))
    for vertex, others in enumerate(near):
        weights = areas[others] / max(areas[others].sum(), 1e-12)
        flat = np.linalg.norm(weights @ mesh.normals[others])
        worth[vertex] = flat**_BENT * (weights @ values[others])
    return worth


def next_aim(
    mesh: Mesh,
    patches: Sequence[Patch],
    tried: Sequence[Aim],
    is_reachable: Callable[[Aim], bool],
    news: Array | None = None,
) -> Aim | None:
    """Choose the next point to touch; None if none is left. `tried` are the earlier targets,
    including touches without contact. `news` (V,), m, is the information from a touch at each
    vertex about the sizes."""
    past = [patch.center for patch in patches] + [aim.p_H for aim in tried]
    worth = _mean_around(mesh, mesh.sd if news is None else mesh.sd + news)
    if past:
        distances = np.linalg.norm(mesh.vertices[:, None] - np.stack(past)[None], axis=2)
        worth = worth * np.minimum(distances.min(axis=1) / _NEAR, 1.0)
    for vertex in np.argsort(-worth):
        aim = Aim(mesh.vertices[vertex], mesh.normals[vertex])
        if worth[vertex] > 0 and is_reachable(aim):
            return aim
    return None
