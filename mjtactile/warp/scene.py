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

from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.plugin.attach import AttachedSensor
from mjtactile.plugin.sim_finger import OUTPUTS
from mjtactile.sim.sensor.feature_size import name_of
from mjtactile.sim.sensor.membrane import BODY
from mjtactile.sim.sensor.quasistatic_geoms import ContactGeoms
from mjtactile.warp.device.obstacles import CONVEX, SPHERE, SUPPORTED
from mjtactile.warp.device.sensor_geoms import SensorGeoms
from mjtactile.warp.membranes import Iteration, Membranes
from mjtactile.warp.touch import Touch


def bind(
    model: mujoco.MjModel,
    m: Any,
    d: Any,
    fingers: Sequence[AttachedSensor],
    *,
    iteration: Iteration | None = None,
) -> Touch:
    """Add sensors to all worlds of a MuJoCo Warp scene, inflated, sealed and without contact.

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
    prefixes = [finger.membrane.prefix for finger in fingers]
    bodies = [model.body(prefix + BODY).id for prefix in prefixes]
    outputs = np.array(
        [[_address(model, prefix + name) for name in OUTPUTS] for prefix in prefixes]
    )
    return bind_bodies(model, m, d, bodies, design, grid, iteration=iteration, outputs=outputs)


def bind_bodies(
    model: mujoco.MjModel,
    m: Any,
    d: Any,
    bodies: Sequence[int],
    design: Any,
    grid: tuple[int, int],
    *,
    iteration: Iteration | None = None,
    outputs: Array | None = None,
    inertia: Any = None,
) -> Touch:
    """Do the work of `bind` for sensors of one `design` on the MuJoCo `bodies`.

    `outputs` (fingers, 3) are the addresses of their values in `sensordata`, -1 if absent.
    `inertia` (worlds, nv) is the diagonal of the mass matrix, if it differs between worlds.
    """
    if m.callback.passive is not None:
        raise InputError("has a passive callback already", source="bind", field="m")
    sensor_geoms, planes = _sensor_geoms(model, m, bodies, design, grid)
    rows = np.full((len(bodies), len(OUTPUTS)), -1) if outputs is None else outputs
    sensor_geoms.outputs = wp.array(rows.astype(np.int32), dtype=int)
    membranes = Membranes(
        design,
        d.nworld * len(bodies),
        slots=int(sensor_geoms.geoms.shape[1]),
        grid=grid,
        device=str(d.xpos.device),
        iteration=iteration,
        planes=planes,
    )
    with wp.ScopedDevice(membranes.device):
        touch = Touch(model, m, d, membranes, sensor_geoms)
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


def _sensor_geoms(
    model: mujoco.MjModel, m: Any, frames: Sequence[int], design: Any, grid: tuple[int, int]
) -> tuple[Any, Array]:
    """Return the geoms and bodies that each finger may touch, and the planes of the convex ones."""
    from mjtactile.sim.sensor.quasistatic_geoms import membrane_of

    membrane = membrane_of(design, grid)
    top = float(membrane.rest.x[2].max())
    radius = math.hypot(math.hypot(design.frame.length, design.frame.width) / 2, top) + 1e-3
    found = [ContactGeoms(model, frame, fixed_to_world=True) for frame in frames]
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
                name = name_of(model, int(geom))
                raise InputError(f"{name!r} has a shape that is not supported", source="bind")
            if kind == SPHERE:
                _require_ball(model, int(geom), membrane.spacing)
            tables["geoms"][i, k], tables["kinds"][i, k] = geom, kind
            tables["slots"][i, k] = part.slots[k]
            if kind == CONVEX:
                touchable.add(int(geom))
    sensor_geoms = SensorGeoms()
    sensor_geoms.frames = wp.array(np.array(frames, np.int32), dtype=int)
    for name, table in tables.items():
        setattr(sensor_geoms, name, wp.array(table, dtype=int))
    sensor_geoms.bodies = wp.array(listed, dtype=int)
    sensor_geoms.rbound, sensor_geoms.box = m.geom_rbound, m.geom_aabb
    sensor_geoms.radius = radius
    depth, roof = design.chamber.depth, membrane.roof
    sensor_geoms.middle = wp.vec3(0.0, 0.0, (roof - depth) / 2)
    sensor_geoms.half = wp.vec3(design.frame.length / 2, design.frame.width / 2, (roof + depth) / 2)
    sensor_geoms.mesh = m.geom_dataid
    first, count, planes = _plane_table(model, touchable)
    sensor_geoms.first, sensor_geoms.count = wp.array(first, dtype=int), wp.array(count, dtype=int)
    return sensor_geoms, planes


def _plane_table(model: mujoco.MjModel, geoms: set[int]) -> tuple[Array, Array, Array]:
    """Return first row and count of each mesh in the table of planes, and the table (n, 4)."""
    first, count = np.zeros((2, max(model.nmesh, 1)), np.int32)
    planes = []
    for mesh in _meshes(model, geoms):
        planes.append(_planes(model, mesh))
        first[mesh], count[mesh] = sum(len(rows) for rows in planes[:-1]), len(planes[-1])
    return first, count, np.concatenate(planes) if planes else np.zeros((1, 4))


def _require_ball(model: mujoco.MjModel, geom: int, spacing: float) -> None:
    """Raise InputError for a ball that is smaller than the nodes' spacing, m."""
    radius = float(model.geom_size[geom, 0])
    if radius < spacing:
        text = f"is a ball of {1e3 * radius:.1f} mm radius; at least {1e3 * spacing:.1f} mm, the "
        text += "spacing of the nodes, or contype=0: it then touches no membrane"
        raise InputError(text, source="bind", field=name_of(model, geom))


def _address(model: mujoco.MjModel, name: str) -> int:
    """Return the index of a sensor's values in `sensordata`, -1 if the model has no such sensor."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    return int(model.sensor_adr[found]) if found >= 0 else -1


def _meshes(model: mujoco.MjModel, geoms: set[int]) -> list[int]:
    """Return the meshes of `geoms`, and those that no geom has: other worlds may use them.

    A mesh without a hull, such as that of a `<tactile>` sensor, cannot be a geom.
    """
    used = {int(model.geom_dataid[geom]) for geom in range(model.ngeom)}
    mesh_ids = {int(model.geom_dataid[geom]) for geom in geoms}
    solid = {mesh for mesh in range(model.nmesh) if model.mesh_graphadr[mesh] >= 0}
    others = solid - used if geoms else set()
    return sorted(mesh_ids | others)


def _planes(model: mujoco.MjModel, mesh: int) -> Array:
    """Return the planes (n, 4) of a mesh's convex hull in its frame: normal, distance."""
    from scipy.spatial import ConvexHull  # takes a while to import

    first = int(model.mesh_vertadr[mesh])
    hull = ConvexHull(model.mesh_vert[first : first + model.mesh_vertnum[mesh]])
    rows = np.unique(np.round(hull.equations, 9), axis=0)
    return np.column_stack([rows[:, :3], -rows[:, 3]])
