"""Geometric check for tunneling: interior points of an object that are behind the membrane."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor.feature_size import core
from mjtactile.sim.sensor.mesh import MembraneMesh

_SLACK = 0.3e-3  # tolerance, m: triangles may overlap a thin object by this much while they settle
# tolerance, in vertex spacings, for sharp geoms between vertices, where only vertices make contact
_BETWEEN = 0.6


class CorePoints:
    """Interior points of the geoms that a sensor can touch, about as deep as each geom is thin."""

    def __init__(
        self, model: mujoco.MjModel, geoms: NDArray[np.int64], mesh: MembraneMesh, contact: str
    ):
        self._model = model
        self._mesh = mesh
        self._on_vertices = contact in ("vertices", "quasistatic")
        self._slack = _BETWEEN * mesh.spacing if self._on_vertices else _SLACK
        self._points = {int(geom): core(model, int(geom)) for geom in geoms}
        self._inside: set[int] = set()

    def forget(self, data: mujoco.MjData, body: int, p_SV: Array, depth: float) -> None:
        """Exclude geoms that are behind the membrane from the start: parts of the carrier."""
        behind = [geom for geom in self._points if self.behind(data, body, p_SV, geom, depth)]
        self._inside.update(behind)

    def behind(self, data: mujoco.MjData, body: int, p_SV: Array, geom: int, depth: float) -> bool:
        """Return True if a point inside `geom` is in the chamber of `depth` m behind `p_SV` (n, 3)
        m."""
        core = self._points[geom]
        if geom in self._inside or not len(core):
            return False
        R_WS = data.xmat[body].reshape(3, 3)
        R_WG = data.geom_xmat[geom].reshape(3, 3)
        points = (data.geom_xpos[geom] + core @ R_WG.T - data.xpos[body]) @ R_WS
        is_below_top = points[:, 2] < p_SV[:, 2].max() - self._slack
        is_in_chamber = points[:, 2] > -depth
        points = points[is_below_top & is_in_chamber]
        if not len(points):
            return False
        corners = p_SV[self._mesh.triangles]
        if self._on_vertices:
            # a face's edge may lie within a triangle's slope, but not below its lowest vertex
            corners[..., 2] = corners[..., 2].min(axis=1, keepdims=True)
        heights = _heights(corners, points[:, :2])
        return bool((points[:, 2] < heights - self._slack).any())


def _heights(triangles: Array, positions: Array) -> Array:
    """Return the heights (n,), m, of `triangles` (m, 3, 3), m, over `positions` (n, 2), m; -inf
    outside."""
    a, b, c = triangles.transpose(1, 0, 2)
    u = b - a
    v = c - a
    # twice the area; relative to a, a point has coordinates `along_u` and `along_v` along the sides
    # u and v
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    twice = np.where(np.abs(twice) > 1e-15, twice, np.inf)
    # offsets (n, m) of each point from each triangle's first corner
    x = positions[:, None, 0] - a[None, :, 0]
    y = positions[:, None, 1] - a[None, :, 1]
    along_u = (x * v[:, 1] - y * v[:, 0]) / twice
    along_v = (y * u[:, 0] - x * u[:, 1]) / twice
    is_inside = (along_u >= 0) & (along_v >= 0) & (along_u + along_v <= 1) & np.isfinite(twice)
    heights = a[:, 2] + along_u * u[:, 2] + along_v * v[:, 2]
    return np.where(is_inside, heights, -np.inf).max(axis=1)
