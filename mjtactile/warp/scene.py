"""Membranes in scenes of MuJoCo Warp: `bind`.

`mujoco_warp.step` calls the membranes after positions and velocities are known. One kernel finds
their equilibrium on the geoms' poses and their friction. A second one adds the forces to the
scene's passive forces, with damping that keeps free bodies stable at any time step (decision 32).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import warp as wp

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.plugin.attach import AttachedSensor
from mjtactile.quasistatic.solution import TENSION
from mjtactile.sim.sensor.effect_switches import Effect
from mjtactile.sim.sensor.membrane import BODY
from mjtactile.sim.sensor.quasistatic_geoms import ContactGeoms
from mjtactile.warp.device.contact import Patch
from mjtactile.warp.device.forces import Joints, Stiffness, add_forces
from mjtactile.warp.device.obstacles import CONVEX, SUPPORTED
from mjtactile.warp.device.update import Heat, Places, States, reset_worlds, update_all
from mjtactile.warp.membranes import Iteration, Membranes
from mjtactile.warp.sticking import sticking_table

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class Touch:
    """Tactile sensors in all worlds of one scene; `bind` makes it.

    Its arrays stay on the device, and every `mujoco_warp.step` updates them:

    - `wrench` (worlds, fingers, 6): N and N m on the membrane, about the origin of S.
    - `pressure` (worlds, fingers): gauge pressure, Pa.
    - `status` (worlds, fingers): 0 if the last solution is an equilibrium, 1 if it is not yet one,
      else the reason for its rejection (`mjtactile.quasistatic.MembraneStatus`). A rejected
      solution keeps the last good one, in its own world only.
    - `area` m^2, and of the body with the largest force: `center` m in S, `slides` (1 at the
      friction limit), `slid` m since first touch. All are (worlds, fingers).
    - `friction`, `modulus` (a factor), `sealed` and `supply` (worlds, fingers) may be written.
      Where `sealed` is 0, a valve connects the chamber to `supply`, Pa (gauge). `reset` seals the
      chamber with the sensor's pressure at `rest_volume`, m^3, which may be written, too.
    """

    def __init__(self, model: mujoco.MjModel, m: Any, d: Any, membranes: Membranes, places: Any):
        self.membranes = membranes
        self._m, self._places = m, places
        count, worlds = membranes.count, d.nworld
        self.worlds, self.fingers = worlds, count // worlds
        fields = membranes.fields
        self._states = states = _states(membranes, places)
        self._table = sticking_table(membranes.membrane)
        self._heat = _heat(membranes, float(model.opt.timestep))
        self._joints = _joints(model, worlds)
        self._stiffness = _stiffness(membranes)
        shape = (worlds, self.fingers)
        # the same, of all membranes in one row: (worlds * fingers, ...)
        self.membrane_wrench, self.membrane_status = states.wrench, fields.status
        self.membrane_friction = states.friction
        rest = float(membranes.membrane.rest.volume)
        self.membrane_volume = wp.full(count, rest, dtype=float)
        self.rest_volume = self.membrane_volume.reshape((worlds, self.fingers))
        self.wrench = states.wrench.reshape((*shape, 6))
        self.pressure = fields.pressure.reshape(shape)
        self.status = fields.status.reshape(shape)
        self.area = states.area.reshape(shape)
        self.center = states.center.reshape(shape)
        self.slides = states.slides.reshape(shape)
        self.slid = states.slid.reshape(shape)
        self.friction = states.friction.reshape(shape)
        self.modulus = membranes.modulus.reshape(shape)
        self.sealed = membranes.gas.sealed.reshape(shape)
        self.supply = self._heat.supply.reshape(shape)
        m.dof_damping = self._joints.damping
        self.reset()

    def update(self, m: Any, d: Any) -> None:
        """Find the equilibria on the present poses, and add the forces.

        `mujoco_warp.step` calls it.
        """
        part = self.membranes
        wp.launch_tiled(
            update_all,
            dim=[part.count],
            inputs=[
                *(
                    part.rubber,
                    part.scheme,
                    part.gas,
                    self._heat,
                    self._table,
                    self._places,
                    self._states,
                ),
                *(part.geoms, part.pool, part.modulus, part.fields, m.geom_size),
                *(d.xpos, d.xmat, d.geom_xpos, d.geom_xmat),
            ],
            block_dim=part.block,
        )
        wp.launch(
            add_forces,
            dim=self.worlds,
            inputs=[
                *(part.rubber, part.gas, self._stiffness, part.fields, self._places, self._joints),
                *(self._states.patches, m.opt.timestep, d.xpos, d.xmat, d.xanchor, d.xaxis),
                *(d.qvel, d.qfrc_passive),
            ],
        )

    def reset(self, mask: Any = None) -> None:
        """Return membranes to rest without contact in the worlds that start again.

        Args:
            mask: (worlds,) bool array of Warp; None: all worlds.
        """
        if mask is None:
            mask = wp.full(self.worlds, True, dtype=bool)
        membrane = self.membranes.membrane
        wp.launch(
            reset_worlds,
            dim=(self.membranes.count, self.membranes.rubber.rest.shape[1]),
            inputs=[
                *(self.fingers, mask, self.membranes.rubber.rest, float(membrane.gauge_pressure)),
                *(float(membrane.rest.volume), self.membrane_volume, self.membranes.gas),
                self._heat,
                *(self.membranes.fields, self._states),
            ],
        )

    def failures(self) -> int:
        """Return the number of membranes whose last solution was rejected. Waits for the device."""
        return int((self.status.numpy() > 1).sum())


def bind(
    model: mujoco.MjModel,
    m: Any,
    d: Any,
    fingers: Sequence[AttachedSensor],
    *,
    iteration: Iteration | None = None,
) -> Touch:
    """Put sensors into all worlds of a MuJoCo Warp scene, inflated, sealed and untouched.

    Args:
        model: Compiled from the spec to which the sensors were attached with `effects` without
            "mesh".
        m: `mujoco_warp.put_model(model)`; its passive callback is set.
        d: `mujoco_warp.put_data(model, ..., nworld=...)`.
        fingers: Sensors from `mjtactile.attach`, all of one design.
        iteration: Iteration of a solution; None: the default.

    Returns:
        The sensors' results on the device.

    Raises:
        InputError: No sensors, different designs, a sensor with a mesh, a callback that is already
            set, or geoms that the membrane does not support.
    """
    design, grid = _common(fingers)
    bodies = [model.body(finger.membrane.prefix + BODY).id for finger in fingers]
    return bind_bodies(model, m, d, bodies, design, grid, iteration=iteration)


def bind_bodies(
    model: mujoco.MjModel,
    m: Any,
    d: Any,
    bodies: Sequence[int],
    design: Any,
    grid: tuple[int, int],
    *,
    iteration: Iteration | None = None,
    inertia: Any = None,
) -> Touch:
    """Do the work of `bind` for sensors of one `design` on the MuJoCo `bodies`.

    `inertia` (worlds, nv) is the diagonal of the mass matrix, if it differs between worlds.
    """
    if m.callback.passive is not None:
        raise InputError("has a passive callback already", source="bind", field="m")
    places, planes = _places(model, m, bodies, design, grid)
    membranes = Membranes(
        design,
        d.nworld * len(bodies),
        slots=int(places.geoms.shape[1]),
        grid=grid,
        device=str(d.xpos.device),
        iteration=iteration,
        planes=planes,
    )
    with wp.ScopedDevice(membranes.device):
        touch = Touch(model, m, d, membranes, places)
        if inertia is not None:
            touch._joints.inertia = inertia
    m.callback.passive = touch.update
    return touch


def _common(fingers: Sequence[AttachedSensor]) -> tuple[Any, tuple[int, int]]:
    if not fingers:
        raise InputError("is empty; at least one sensor is needed", source="bind", field="fingers")
    parts = [finger.membrane for finger in fingers]
    if any(Effect.MESH in part.effects for part in parts):
        raise InputError(
            "a sensor has a mesh, which runs on the CPU only; attach it with effects='-mesh'",
            source="bind",
            field="fingers",
        )
    if any(part.design != parts[0].design for part in parts):
        raise InputError("the sensors differ; one design is needed", source="bind", field="fingers")
    return parts[0].design, (parts[0].mesh.nx, parts[0].mesh.ny)


def _places(
    model: mujoco.MjModel, m: Any, frames: Sequence[int], design: Any, grid: tuple[int, int]
) -> tuple[Any, Array]:
    """Return the geoms and bodies that each finger may touch, and the planes of the convex ones."""
    from mjtactile.sim.sensor.quasistatic_geoms import membrane_of

    top = float(membrane_of(design, grid).rest.x[2].max())
    radius = math.hypot(math.hypot(design.frame.length, design.frame.width) / 2, top) + 1e-3
    found = [ContactGeoms(model, frame, radius) for frame in frames]
    geoms = max(1, *(len(part.ids) for part in found))
    bodies = max(1, *(len(part.bodies) for part in found))
    tables = {
        name: np.full((len(frames), geoms), -1, np.int32) for name in ("geoms", "kinds", "slots")
    }
    listed = np.full((len(frames), bodies), -1, np.int32)
    touchable: set[int] = set()
    for i, part in enumerate(found):
        listed[i, : len(part.bodies)] = part.bodies
        for k, geom in enumerate(part.ids):
            kind = int(model.geom_type[geom])
            if kind not in SUPPORTED:
                name = model.geom(int(geom)).name or f"geom {geom}"
                raise InputError(f"{name!r} has a shape that is not supported", source="bind")
            tables["geoms"][i, k], tables["kinds"][i, k] = geom, kind
            tables["slots"][i, k] = part.slots[k]
            if kind == CONVEX:
                touchable.add(int(geom))
    places = Places()
    places.frames = wp.array(np.array(frames, np.int32), dtype=int)
    for name, table in tables.items():
        setattr(places, name, wp.array(table, dtype=int))
    places.bodies = wp.array(listed, dtype=int)
    places.rbound = m.geom_rbound
    places.radius = radius
    places.mesh = m.geom_dataid
    first, count = np.zeros((2, max(model.nmesh, 1)), np.int32)
    planes = []
    for mesh in _meshes(model, touchable):
        planes.append(_planes(model, mesh))
        first[mesh], count[mesh] = sum(len(rows) for rows in planes[:-1]), len(planes[-1])
    places.first, places.count = wp.array(first, dtype=int), wp.array(count, dtype=int)
    return places, np.concatenate(planes) if planes else np.zeros((1, 4))


def _meshes(model: mujoco.MjModel, geoms: set[int]) -> list[int]:
    """Return the meshes of `geoms`, and those that no geom has: other worlds may use them.

    A mesh without a hull, such as that of a `<tactile>` sensor, cannot be a geom.
    """
    used = {int(model.geom_dataid[geom]) for geom in range(model.ngeom)}
    own = {int(model.geom_dataid[geom]) for geom in geoms}
    solid = {mesh for mesh in range(model.nmesh) if model.mesh_graphadr[mesh] >= 0}
    others = solid - used if geoms else set()
    return sorted(own | others)


def _planes(model: mujoco.MjModel, mesh: int) -> Array:
    """Return the planes (n, 4) of a mesh's convex hull in its frame: normal, distance."""
    from scipy.spatial import ConvexHull  # takes a while to import

    first = int(model.mesh_vertadr[mesh])
    hull = ConvexHull(model.mesh_vert[first : first + model.mesh_vertnum[mesh]])
    rows = np.unique(np.round(hull.equations, 9), axis=0)
    return np.column_stack([rows[:, :3], -rows[:, 3]])


def _states(membranes: Membranes, places: Any) -> Any:
    count, nodes = membranes.count, membranes.grid[0] * membranes.grid[1]
    states = States()
    states.patches = wp.zeros((count, places.bodies.shape[1]), dtype=Patch)
    states.before = wp.zeros((count, 3, nodes), dtype=float)
    friction = float(membranes.design.membrane.friction)
    states.friction = wp.full(count, friction, dtype=float)
    states.wrench = wp.zeros((count, 6), dtype=float)
    states.area, states.slid = wp.zeros(count, dtype=float), wp.zeros(count, dtype=float)
    states.slides = wp.zeros(count, dtype=int)
    states.center = wp.zeros(count, dtype=wp.vec3)
    return states


def _heat(membranes: Membranes, step: float) -> Any:
    """Return the gas's memory, and set the exponent of its response within a step."""
    chamber, gas = membranes.design.chamber, membranes.gas
    heat = Heat()
    for name in ("amount", "warmth", "volume", "supply"):
        setattr(heat, name, wp.zeros(membranes.count, dtype=float))
    heat.exchange = step / chamber.heat_exchange
    heat.gamma = float(chamber.polytropic_exponent)
    lost = -math.expm1(-heat.exchange) / heat.exchange if heat.exchange else 1.0
    gas.exponent = 1 + (chamber.polytropic_exponent - 1) * lost
    return heat


def _joints(model: mujoco.MjModel, worlds: int) -> Any:
    joints = Joints()
    for name, values in {
        "parent": model.body_parentid,
        "count": model.body_jntnum,
        "first": model.body_jntadr,
        "kind": model.jnt_type,
        "dof": model.jnt_dofadr,
        "free": [_carried(model, body) for body in range(model.nbody)],
    }.items():
        setattr(joints, name, wp.array(np.asarray(values, np.int32), dtype=int))
    joints.inertia = wp.array(model.dof_M0[None].astype(np.float32), dtype=float)
    own = np.asarray(model.dof_damping, np.float32).reshape(-1)[: model.nv]
    joints.own = wp.array(own, dtype=float)
    joints.damping = wp.array(np.tile(own, (worlds, 1)), dtype=float)
    return joints


def _carried(model: mujoco.MjModel, body: int) -> int:
    """Return the body whose free joint carries `body`, or -1."""
    while body > 0:
        first = int(model.body_jntadr[body])
        if model.body_jntnum[body] == 1 and model.jnt_type[first] == _FREE:
            return body
        body = int(model.body_parentid[body])
    return -1


def _stiffness(membranes: Membranes) -> Any:
    stiffness = Stiffness()
    stiffness.tension = float(membranes.membrane.rest.found[TENSION])
    stiffness.half = math.sqrt(membranes.design.frame.area / math.pi)
    stiffness.bulge = float(membranes.scheme.bulge)
    return stiffness
