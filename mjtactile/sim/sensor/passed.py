"""What went through a membrane, by geometry: points inside of an object that are behind the
sheet."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor import features
from mjtactile.sim.sensor.mesh import MembraneMesh

_MOST_POINTS = 300  # of a mesh
_SLACK = 0.3e-3  # m: triangles may stand in a thin thing by so much while they find their place
_BETWEEN = 0.6  # spacings that a sharp thing may stand between vertices, where only they are met
_ALONG = np.linspace(-1, 1, 9)


class CorePoints:
    """Points inside of what a sensor may feel, about as deep below its surface as it is thin.

    An object that is held is above the sheet with all of them; one that went through, or sticks
    through, is not.
    """

    def __init__(
        self, model: mujoco.MjModel, geoms: NDArray[np.int64], mesh: MembraneMesh, contact: str
    ):
        self._model = model
        self._mesh = mesh
        self._slack = _SLACK if contact != "vertices" else _BETWEEN * mesh.spacing
        self._points = {int(geom): _core(model, int(geom)) for geom in geoms}
        self._inside: set[int] = set()

    def forget(self, data: mujoco.MjData, body: int, p_SV: Array, depth: float) -> None:
        """Leave out what is behind the sheet from the start: parts of what carries the sensor."""
        behind = [geom for geom in self._points if self.behind(data, body, p_SV, geom, depth)]
        self._inside.update(behind)

    def behind(self, data: mujoco.MjData, body: int, p_SV: Array, geom: int, depth: float) -> bool:
        """Whether a point inside `geom` is behind the sheet.

        Args:
            data: The scene's state.
            body: The sensor's body.
            p_SV: Vertices (n, 3) m of the sheet, in S.
            geom: One of the geoms that the sensor may feel.
            depth: Of the chamber behind the sheet, m.
        """
        core = self._points[geom]
        if geom in self._inside or not len(core):
            return False
        R_WS = data.xmat[body].reshape(3, 3)
        R_WG = data.geom_xmat[geom].reshape(3, 3)
        points = (data.geom_xpos[geom] + core @ R_WG.T - data.xpos[body]) @ R_WS
        low = (points[:, 2] < p_SV[:, 2].max() - self._slack) & (points[:, 2] > -depth)
        points = points[low]
        if not len(points):
            return False
        heights = _heights(p_SV, self._mesh.triangles, points[:, :2])
        return bool((points[:, 2] < heights - self._slack).any())


def _heights(p_SV: Array, triangles: NDArray[np.int64], places: Array) -> Array:
    """Heights (n,) m of the sheet over `places` (n, 2) m; -inf outside of it."""
    a, b, c = (p_SV[triangles[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    twice = np.where(np.abs(twice) > 1e-15, twice, np.inf)
    x, y = (places[:, None, axis] - a[None, :, axis] for axis in range(2))
    along_u = (x * v[:, 1] - y * v[:, 0]) / twice
    along_v = (y * u[:, 0] - x * u[:, 1]) / twice
    inside = (along_u >= 0) & (along_v >= 0) & (along_u + along_v <= 1) & np.isfinite(twice)
    heights = a[:, 2] + along_u * u[:, 2] + along_v * v[:, 2]
    return np.where(inside, heights, -np.inf).max(axis=1)


def _core(model: mujoco.MjModel, geom: int) -> Array:
    """Points (n, 3) m inside a geom, in its frame; none of a plane or height field."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    size = np.asarray(model.geom_size[geom], float)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3))
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.concatenate([np.zeros((1, 3)), 0.7 * np.diag(size), -0.7 * np.diag(size)])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return _ALONG[:, None] * (0.0, 0.0, size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        least = min(size[0], size[1])
        angles = np.arange(8) * np.pi / 4
        ring = (size[0] - least) * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        axis = _ALONG[:, None] * (0.0, 0.0, size[1] - least)
        return (axis[:, None] + ring).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        grid = np.stack(np.meshgrid(_ALONG, _ALONG, _ALONG, indexing="ij"), axis=-1).reshape(-1, 3)
        return np.unique(grid * (size - size.min()), axis=0)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh_core(model, geom)
    return np.zeros((0, 3))


def _mesh_core(model: mujoco.MjModel, geom: int) -> Array:
    """Vertices and points of edges of a mesh, pulled to its middle by as much as it is thin."""
    mesh = int(model.geom_dataid[geom])
    vertices = slice(int(model.mesh_vertadr[mesh]), None)
    corners = np.asarray(model.mesh_vert[vertices][: model.mesh_vertnum[mesh]], float)
    first = int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[first : first + model.mesh_facenum[mesh]]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]]), axis=1), axis=0)
    shares = np.linspace(0.125, 0.875, 7)[:, None, None]
    between = (1 - shares) * corners[edges[:, 0]] + shares * corners[edges[:, 1]]
    points = np.concatenate([corners, between.reshape(-1, 3)])
    points = points[:: max(1, len(points) // _MOST_POINTS)]
    away = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)
    thin = features.feature_radius(model, geom)
    return points * np.maximum(1 - thin / away, 0.0)
