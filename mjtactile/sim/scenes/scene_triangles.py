"""Scene as coloured triangles, for `mjtactile.report.software_renderer`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

_SHOWN = 3  # MuJoCo's viewers hide the geoms of this group and above
# number of edges around and along a round shape
_ROUND = 24
_HIGH = 12
_MEMBRANE_COLOR = np.array([0.62, 0.78, 0.95, 1.0])  # a membrane
_PRISM = np.array([[-1.0, 0.0], [-1.0, 1.0], [1.0, 1.0], [1.0, 0.0]])  # heights and radii
_G = mujoco.mjtGeom
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@dataclass(frozen=True, eq=False)
class Solid:
    """A geom: surface points (n, 3) m and triangles (m, 3) in its own frame, color (4,), and
    pose."""

    name: str
    points: Array
    faces: Array
    rgba: Array
    R_WG: Array
    p_WG: Array

    @property
    def points_W(self) -> Array:
        """The points in W."""
        return self.points @ self.R_WG.T + self.p_WG


@dataclass(frozen=True, eq=False)
class SceneView:
    """Poses of all scene elements at one time. Triangles are computed on demand.

    `p_WS` (s, 3) m and `R_WS` (s, 3, 3) are the poses of the sensors' frames. `state` is MuJoCo's
    (mjSTATE_INTEGRATION).
    """

    model: mujoco.MjModel
    geom_p_W: Array
    geom_R_W: Array
    vertex_p_W: Array
    p_WS: Array
    R_WS: Array
    hidden: tuple[NDArray[np.int64], ...]
    state: Array
    membranes: tuple[tuple[Callable[[], Array], Array, Array, NDArray[np.int64]], ...] = ()
    """Membranes outside the model: points (n, 3) m in S on demand, R_WS, p_WS, triangles."""

    @classmethod
    def of(cls, world: World) -> SceneView:
        """Store the current scene. The world must be paused."""
        data = world.data
        bodies = [sensor.body_id for sensor in world.sensors]
        # contact spheres of a membrane
        spheres = tuple(sensor.vertex_geom_ids for sensor in world.sensors)
        state = np.empty(mujoco.mj_stateSize(world.model, _STATE))
        mujoco.mj_getState(world.model, data, state, _STATE)
        return cls(
            world.model,
            data.geom_xpos.copy(),
            data.geom_xmat.reshape(-1, 3, 3).copy(),
            data.flexvert_xpos.copy(),
            data.xpos[bodies].copy(),
            data.xmat[bodies].reshape(-1, 3, 3).copy(),
            spheres,
            state,
            tuple(
                (
                    sensor.positions_now(),
                    data.xmat[sensor.body_id].reshape(3, 3).copy(),
                    data.xpos[sensor.body_id].copy(),
                    sensor.mesh.triangles,
                )
                for sensor in world.sensors
                if isinstance(sensor, QuasistaticSensor)
            ),
        )

    def triangles(self) -> tuple[Array, Array]:
        """Return the corners (n, 3, 3), m, in W, and the colors (n, 4): red, green, blue, alpha, 0
        to 1."""
        geoms = [(solid.points_W, solid.faces, solid.rgba) for solid in self.solids()]
        parts = [*geoms, *self._flexes()]
        corners = np.concatenate([points[faces] for points, faces, _ in parts])
        return corners, np.concatenate([np.tile(rgba, (len(faces), 1)) for _, faces, rgba in parts])

    def object_triangles(self) -> Array:
        """Return the triangle corners (n, 3, 3), m, in W, of everything except the membranes."""
        rigid = [solid.points_W[solid.faces] for solid in self.solids()]
        soft = [points[faces] for _, points, faces, _ in self.soft_bodies()]
        return np.concatenate([np.zeros((0, 3, 3)), *rigid, *soft])

    def solids(self) -> Iterator[Solid]:
        """Yield all visible geoms."""
        model = self.model
        hidden = {geom for ids in self.hidden for geom in ids.tolist()}
        for geom in range(model.ngeom):
            if model.geom_matid[geom] < 0:
                rgba = model.geom_rgba[geom]
            else:
                rgba = model.mat_rgba[model.geom_matid[geom]]
            if geom in hidden or model.geom_group[geom] >= _SHOWN or rgba[3] == 0:
                continue
            points, faces = _shape(model, geom)
            if not len(faces):
                continue
            name = model.geom(geom).name or f"{model.body(model.geom_bodyid[geom]).name}/{geom}"
            R_WG = self.geom_R_W[geom]
            yield Solid(name, points, faces, rgba, R_WG, self.geom_p_W[geom])

    def soft_bodies(self) -> Iterator[tuple[str, Array, Array, Array]]:
        """Return the skins of soft objects: name, points (n, 3) m in W, triangles, color."""
        for flex in range(self.model.nflex):
            if self.model.flex_dim[flex] == 3:
                ((_, faces, rgba),) = self._flex(flex)
                yield self.model.flex(flex).name, self.vertex_p_W, faces, rgba

    def _flexes(self) -> Iterator[tuple[Array, Array, Array]]:
        """Return the surfaces of membranes and the skins of soft objects."""
        for flex in range(self.model.nflex):
            yield from self._flex(flex)
        for points_S, R_WS, p_WS, faces in self.membranes:
            yield points_S() @ R_WS.T + p_WS, faces, _MEMBRANE_COLOR

    def _flex(self, flex: int) -> Iterator[tuple[Array, Array, Array]]:
        """Return a membrane, or the skin of a soft object; empty for a rope."""
        model = self.model
        solid = model.flex_dim[flex] == 3
        if solid:
            start = model.flex_shelldataadr[flex]
            count = model.flex_shellnum[flex]
        else:
            start = model.flex_elemdataadr[flex]
            count = model.flex_elemnum[flex]
        index = model.flex_shell if solid else model.flex_elem
        if model.flex_dim[flex] < 2:
            return
        faces = index[start : start + 3 * count].reshape(-1, 3) + model.flex_vertadr[flex]
        yield self.vertex_p_W, faces, model.flex_rgba[flex] if solid else _MEMBRANE_COLOR


def _shape(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Return points (p, 3) m in the geom's frame and triangles (n, 3); empty for a plane."""
    kind = int(model.geom_type[geom])
    size = model.geom_size[geom]
    if kind == _G.mjGEOM_BOX:
        return _grid(_PRISM, size, 4, np.pi / 4, np.sqrt(2))
    if kind == _G.mjGEOM_CYLINDER:
        return _grid(_PRISM, size[[0, 0, 1]], _ROUND)
    if kind == _G.mjGEOM_SPHERE:
        return _grid(_arc(), size[[0, 0, 0]], _ROUND)
    if kind == _G.mjGEOM_ELLIPSOID:
        return _grid(_arc(), size, _ROUND)
    if kind == _G.mjGEOM_CAPSULE:
        points, faces = _grid(_arc(), size[[0, 0, 0]], _ROUND)
        points[:, 2] += np.where(np.arange(len(points)) < len(points) // 2, -size[1], size[1])
        return points, faces
    if kind == _G.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        count = model.mesh_vertnum[mesh]
        start = model.mesh_faceadr[mesh]
        face_count = model.mesh_facenum[mesh]
        return model.mesh_vert[first : first + count].astype(float), model.mesh_face[
            start : start + face_count
        ]
    return np.zeros((0, 3)), np.zeros((0, 3), dtype=int)


def _arc() -> Array:
    """Return heights and radii of a unit sphere from pole to pole, with the equator twice."""
    half = np.linspace(-np.pi / 2, 0, _HIGH // 2 + 1)
    angle = np.concatenate([half, -half[::-1]])
    return np.column_stack([np.sin(angle), np.cos(angle)])


def _grid(
    profile: Array, scale: Array, around: int, turn: float = 0.0, stretch: float = 1.0
) -> tuple[Array, Array]:
    """Return a surface of revolution by its profile, scaled along each axis; a box with four
    edges."""
    angle = 2 * np.pi * np.arange(around) / around + turn
    ring = stretch * np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.concatenate(
        [np.column_stack([radius * ring, np.full(around, height)]) for height, radius in profile]
    )
    rows, columns = np.meshgrid(np.arange(len(profile) - 1), np.arange(around), indexing="ij")
    a = rows * around + columns
    b = rows * around + (columns + 1) % around
    quads = np.stack([a, b, b + around, a, b + around, a + around], axis=-1)
    return points * scale, quads.reshape(-1, 3)
