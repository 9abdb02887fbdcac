"""Quasi-static membranes of sensors without a mesh, and a scene's geoms as their obstacles."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.quasistatic import QuasistaticMembrane, obstacles
from mjtactile.quasistatic.incremental import IncrementalMembrane, Sticking, empty_rows
from mjtactile.quasistatic.obstacles import Obstacle, obstacle
from mjtactile.sim.sensor import feature_size
from mjtactile.sim.sensor.own_links import own_links

QS_GRID = (21, 16)
FEELER = "feeler"
_TOLERANCE = 2  # index in a membrane's settings
_CLOSE = 1e-9  # tolerance, m


def add_feeler(body: mujoco.MjsBody, design: SensorDesign) -> None:
    """Add the geom of a sensor without a mesh. It measures distances and makes no contacts."""
    body.add_geom(
        name=FEELER,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[design.membrane.thickness / 2, 0, 0],
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=4,
    )


@lru_cache(maxsize=64)
def membrane_of(design: SensorDesign, grid: tuple[int, int]) -> QuasistaticMembrane:
    """Return the quasi-static membrane of a sensor, made once per process."""
    return QuasistaticMembrane(design, grid)


@lru_cache(maxsize=64)
def sticking_of(membrane: QuasistaticMembrane) -> Sticking:
    """Return the membrane's in-plane compliance, inverted once per process."""
    sticking = Sticking(membrane)
    sticking.compliance.flags.writeable = False
    return sticking


@lru_cache(maxsize=64)
def bulge_stiffness(membrane: QuasistaticMembrane) -> float:
    """Return dp/dV, Pa/m^3, of the bulge about its rest."""
    step = 0.05 * membrane.gauge_pressure
    live = IncrementalMembrane(membrane, empty_rows(0), None)
    live.x[:] = membrane.rest.x
    live.settings[_TOLERANCE] = _CLOSE
    live.rest_on(membrane.gauge_pressure + step, False, 1.0)
    return step / (live.volume - membrane.rest.volume)


_G = mujoco.mjtGeom
_KINDS = {
    int(_G.mjGEOM_SPHERE): ("sphere", 1),
    int(_G.mjGEOM_CAPSULE): ("capsule", 2),
    int(_G.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
    int(_G.mjGEOM_CYLINDER): ("cylinder", 2),
    int(_G.mjGEOM_BOX): ("box", 3),
}

# half-extents, m, of the block below a plane's origin that stands for the plane
_PLANE_HALF = np.array([5.0, 5.0, 0.5])
_PLANE_CORNERS = np.array(
    [(x, y, z) for x in (-5.0, 5.0) for y in (-5.0, 5.0) for z in (-1.0, 0.0)], np.float32
)


class ContactGeoms:
    """Geoms that a quasi-static membrane can touch, as rows of obstacles in its sensor's frame.

    `ids` (k,) are the geoms and `rows` (k, NUMBERS) their obstacles, whose poses the kernel writes.
    Geoms that are fixed to each other form a patch: `slots` (k,) are their patches and `bodies`
    (n,) the MuJoCo bodies that carry these. `pool` holds the planes of the meshes' hulls, or is
    None. `bounds` (k, 6): center and half-extents, m, of a geom's bounding box.
    """

    def __init__(self, model: mujoco.MjModel, body: int, *, fixed_to_world: bool = False):
        """Collect the geoms that may touch the sensor's `body`, without its own links, and without
        those fixed to the world if `fixed_to_world` is False.

        Raises InputError for movable soft objects and height fields. Those fixed to the world do
        not touch the membrane.
        """
        movable = feature_size.touching_geoms(model)
        touching = feature_size.touching_geoms(model, body)
        supported = np.isin(model.geom_type[touching], [*_KINDS, _G.mjGEOM_MESH, _G.mjGEOM_PLANE])
        touching = touching[np.isin(touching, movable) | (supported & fixed_to_world)]
        touching = touching[~np.isin(model.geom_bodyid[touching], own_links(model, body))]
        self.ids: NDArray[np.int64] = touching.astype(np.int64)
        made = [_body_of(model, int(geom)) for geom in self.ids]
        filled, self.pool = obstacles.rows_and_pool(made, (0, 0)) if made else (empty_rows(0), None)
        self.rows = np.ascontiguousarray(filled)
        carriers = feature_size.weld_bodies(model)[model.geom_bodyid[self.ids]]
        bodies, slots = np.unique(carriers, return_inverse=True)
        self.bodies: NDArray[np.int64] = bodies.astype(np.int64)
        self.slots: NDArray[np.int64] = slots.astype(np.int64)
        boxes = model.geom_aabb[self.ids].copy()
        planes = model.geom_type[self.ids] == _G.mjGEOM_PLANE
        boxes[planes] = [0.0, 0.0, -_PLANE_HALF[2], *_PLANE_HALF]
        self.bounds = np.ascontiguousarray(boxes)
        _refuse_soft(model)


def _body_of(model: mujoco.MjModel, geom: int) -> Obstacle:
    kind = int(model.geom_type[geom])
    if kind in _KINDS:
        name, count = _KINDS[kind]
        return obstacle(name, model.geom_size[geom, :count])
    if kind == _G.mjGEOM_PLANE:
        return obstacle("mesh", data=_PLANE_CORNERS)
    if kind == _G.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        return obstacle("mesh", data=model.mesh_vert[first : first + model.mesh_vertnum[mesh]])
    name = model.geom(geom).name or f"geom {geom}"
    shape = _G(kind).name.removeprefix("mjGEOM_").lower()
    raise InputError(
        f"{name!r} is a {shape}, which a quasi-static membrane does not support: switch 'mesh' on",
        field="--effects -mesh",
    )


def _refuse_soft(model: mujoco.MjModel) -> None:
    """Raise InputError for a soft object."""
    for flex in range(model.nflex):
        if model.flex_dim[flex] == 3:
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, flex)
            raise InputError(
                f"{name!r} is soft, and a quasi-static membrane supports only rigid bodies: "
                "switch 'mesh' on",
                field="--effects -mesh",
            )
