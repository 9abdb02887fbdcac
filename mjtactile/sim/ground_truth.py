"""Ground truth of a simulated scene, for scoring, benchmarks and tests only.

Forces and positions are in the sensor's frame S unless a name says otherwise; N, m, Pa.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import Frame
from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.sim.scenes.liquid import NAME as LIQUID
from mjtactile.sim.scenes.objects import PREFIX, moving_bodies
from mjtactile.sim.sensor import contact_loads as loads
from mjtactile.sim.sensor.contact_list import listed
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

if TYPE_CHECKING:
    from mjtactile.sim.scenes.gripper_world import GripperWorld
    from mjtactile.sim.scenes.strain import SoftSolid
    from mjtactile.sim.scenes.world import World
    from mjtactile.sim.sensor.mesh_sensor import TactileSensor
    from mjtactile.sim.sensor.sensor_types import AnySensor


def contact_forces(world: World, sensor: int) -> tuple[Array, Array, Array]:
    """Return forces (n, 3) N on membrane `sensor`, points (n, 3) m, and penetration depths (n,) m.

    There is one row per contact, in the order of MuJoCo's contact list.
    """
    data = world.data
    device = world.sensors[sensor]
    if isinstance(device, QuasistaticSensor):
        f_S, p_S = device.contact_forces()
        return f_S, p_S, np.zeros(len(f_S))
    R_WS, p_WS = _pose(world, device)
    rows, sides = loads.on_membrane(data, device)
    f_S = loads.forces(data, rows, sides, R_WS)
    return f_S, (data.contact.pos[rows] - p_WS) @ R_WS, device.penetrations(rows)


def patch(world: World, sensor: int) -> tuple[Array, float]:
    """Return the force-weighted center (3,) m of the contact on membrane `sensor`, and its radius,
    m.

    The radius is the weighted mean distance from the center. Both are 0 without contact.
    """
    device = world.sensors[sensor]
    if isinstance(device, QuasistaticSensor):
        return device.middle, device.radius
    forces, points, _ = contact_forces(world, sensor)
    press = np.maximum(-forces[:, 2], 0.0)
    if press.sum() <= 0:
        return np.zeros(3), 0.0
    fraction = press / press.sum()
    center = fraction @ points
    return center, float(fraction @ np.linalg.norm(points - center, axis=1))


def contact_force(world: World, sensor: int) -> Array:
    """Return the total force (3,), N, on membrane `sensor`; z is negative in contact."""
    return contact_loads(world, [world.sensors[sensor]])[0]


def contact_loads(world: World, devices: Sequence[AnySensor]) -> Array:
    """Return the total forces (n, 3) N on the membranes of `devices`, each in its frame S."""
    if any(isinstance(device, QuasistaticSensor) for device in devices):
        return np.array([loads.membrane_wrench(world.data, device)[:3] for device in devices])
    f_W = np.empty((len(devices), 3))
    kernel("membrane_loads")(
        *listed(world.data),
        world.data.nefc,
        world.data.efc_force,
        len(devices),
        np.array([device.contact_ids for device in devices]),
        f_W,
    )
    return np.array(
        [load @ _pose(world, device)[0] for load, device in zip(f_W, devices, strict=True)]
    )


def step_batch_forces(world: World) -> Array:
    """Return the normal forces (n, sensors) N of the last batch of n steps."""
    if world.batch_forces is None:
        return -contact_loads(world, world.sensors)[None, :, 2]
    return -world.batch_forces[:, :, 2]


def sliding(world: World, sensor: int) -> tuple[float, float]:
    """Return the sliding fraction and sliding speed of membrane `sensor` on the contacting object.

    The best-fitting rigid motion describes the sliding. The fraction is that of the friction limit
    that resists this motion. The speed, m/s, is an rms over the contact weighted by force.
    """
    data = world.data
    device = world.sensors[sensor]
    own = np.isin(data.contact.geom, device.vertex_geom_ids)
    rows = np.flatnonzero(own.any(axis=1) & (data.contact.efc_address >= 0))
    if not len(rows):
        return 0.0, 0.0
    velocity = np.empty(data.nefc)
    first = data.contact.efc_address[rows]
    mujoco.mj_mulJacVec(world.model, data, velocity, data.qvel)
    sign = np.where(own[rows, 1], 1.0, -1.0)[:, None]
    planes = data.contact.frame[rows].reshape(-1, 3, 3)[:, 1:]
    v_W, f_W = (
        sign * np.einsum("nk,nkj->nj", np.stack([rate[first + 1], rate[first + 2]], axis=1), planes)
        for rate in (velocity, data.efc_force)
    )
    normal = data.efc_force[first]
    fraction = normal / max(float(normal.sum()), 1e-9)
    arm = data.contact.pos[rows] - fraction @ data.contact.pos[rows]
    around = np.cross(data.xmat[device.body_id].reshape(3, 3)[:, 2], arm)
    mean = fraction @ v_W
    angular_velocity = float(fraction @ (around * v_W).sum(axis=1)) / max(
        float(fraction @ (around**2).sum(axis=1)), 1e-12
    )
    along = np.einsum(
        "nk,nkj->nj", np.einsum("nj,nkj->nk", mean + angular_velocity * around, planes), planes
    )
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    used = -float((along * f_W).sum()) / max(float(data.contact.friction[rows, 0] @ normal), 1e-9)
    return used, float(
        np.sqrt(mean @ mean + angular_velocity**2 * (fraction @ (arm**2).sum(axis=1)))
    )


def contact_wrench(world: World, sensor: int) -> Array:
    """Return the contact wrench (6,) on membrane `sensor` about the origin of S, N and N m."""
    return loads.membrane_wrench(world.data, world.sensors[sensor])


def frame_load(world: World, sensor: int) -> float:
    """Return the force, N, on a sensor's frame and housing."""
    return loads.frame_load(world.data, world.sensors[sensor])[0]


def contact_area(world: World, sensor: int, spacing: float = 4e-4) -> float:
    """Return the area of the membrane in contact, m^2; 0 without contact.

    Vertices are too far apart to determine the area. `obstacle_problem` determines it on the object
    projected along the sensor's axis, with the same tension, pressure and normal force.
    """
    device = world.sensors[sensor]
    if isinstance(device, QuasistaticSensor):
        return device.contact_area
    forces, points, _ = contact_forces(world, sensor)
    force = -float(forces[:, 2].sum())
    if force <= 0:
        return 0.0
    # lazily: with its solver it takes as long as all of a step's needs
    from mjtactile.sim import obstacle_problem

    frame = device.design.frame
    axes = [
        np.linspace(-side / 2, side / 2, round(side / spacing) + 1)
        for side in (frame.length, frame.width)
    ]
    x, y = np.meshgrid(*axes, indexing="ij")
    inside = _inside(frame, x, y)
    nearest = np.linalg.norm(points[:, None] - device.p_SV, axis=2).argmin(axis=1)
    pressing = np.maximum(-forces[:, 2], 0.0)
    tension = float(pressing @ device.tensions()[nearest] / pressing.sum())
    contact = obstacle_problem.solve_contact(
        _heights_of(world, device, x, y),
        inside,
        spacing,
        pressure=device.gauge_pressure,
        tension=tension,
        force=force,
    )
    return contact.area


def _inside(frame: Frame, x: Array, y: Array) -> NDArray[np.bool_]:
    """Return a mask of the points `x`, `y` (nx, ny) m within the opening."""
    if frame.outline is not None:
        points = np.stack([x, y], axis=-1).reshape(-1, 2)
        return (frame.inside(points) > 0).reshape(x.shape)
    distance = np.abs(np.stack([2 * x / frame.length, 2 * y / frame.width]))
    return distance.max(axis=0) < 1 - 1e-9


def _heights_of(world: World, device: TactileSensor, x: Array, y: Array) -> Array:
    """Return heights (nx, ny) m in S of the contacting objects over points `x`, `y` (nx, ny) m.

    They are those of the first hit along the sensor's axis; inf without a hit.
    """
    model = world.model
    data = world.data
    own = np.isin(data.contact.geom, device.vertex_geom_ids) | (data.contact.flex == device.flex_id)
    others = own.any(axis=1)[:, None] & ~own
    geoms, flexes = (
        np.unique(ids[others & (ids >= 0)]) for ids in (data.contact.geom, data.contact.flex)
    )
    bodies = model.body_weldid[model.geom_bodyid]
    solid = (model.geom_contype | model.geom_conaffinity) > 0
    geoms = np.flatnonzero(
        np.isin(bodies, bodies[geoms])
        & solid
        & ~np.isin(np.arange(model.ngeom), device.vertex_geom_ids)
    )
    R_WS, p_WS = _pose(world, device)
    up = np.ascontiguousarray(R_WS[:, 2])
    below = -device.design.chamber.depth
    heights = np.full(x.shape, np.inf)
    for index in np.ndindex(*x.shape):
        start = p_WS + R_WS @ (x[index], y[index], below)
        distances = [_ray(model, data, int(geom), start, up) for geom in geoms]
        distances += [
            mujoco.mj_rayFlex(model, data, 0, False, False, True, False, int(flex), start, up)
            for flex in flexes
        ]
        heights[index] = below + min(
            (distance for distance in distances if distance >= 0), default=np.inf
        )
    return heights


def _ray(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, start: Array, along: Array
) -> float:
    """Return the distance, m, from `start` to a geom, frame W; -1 if the ray misses it."""
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return mujoco.mj_rayMesh(model, data, geom, start, along)
    return mujoco.mju_rayGeom(
        data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom], start, along, int(kind)
    )


def penetration(world: World, sensor: int) -> float:
    """Return the deepest penetration of an object into membrane `sensor`, m."""
    return float(max(contact_forces(world, sensor)[2].max(initial=0.0), 0.0))


def object_bodies(world: World) -> NDArray[np.int64]:
    """Return the grasped object's MuJoCo bodies, including soft parts."""
    return moving_bodies(world.model, PREFIX)


def solid_bodies(world: World) -> NDArray[np.int64]:
    """Return the grasped object's MuJoCo bodies without those of a liquid in it."""
    model = world.model
    bodies = object_bodies(world)
    return bodies[[not model.body(int(body)).name.startswith(PREFIX + LIQUID) for body in bodies]]


def support_force(world: World, bodies: NDArray[np.int64]) -> float:
    """Return the upward force of static bodies (table, stand) on the object's `bodies`, N."""
    data = world.data
    model = world.model
    if not data.ncon:
        return 0.0
    is_geom = data.contact.geom >= 0
    owner = np.where(is_geom, model.geom_bodyid[data.contact.geom], 0)
    is_object = np.isin(owner, bodies) & is_geom
    is_place = (model.body_weldid[owner] == 0) & is_geom
    both = (is_object & is_place[:, ::-1]).any(axis=1) & (data.contact.efc_address >= 0)
    force = np.zeros(6)
    total = 0.0
    for row in np.flatnonzero(both):
        mujoco.mj_contactForce(model, data, row, force)
        up = float(force[:3] @ data.contact.frame[row].reshape(3, 3)[:, 2])
        total += up if is_object[row, 1] else -up  # it acts on the second
    return total


def object_position(world: World, bodies: NDArray[np.int64] | None = None) -> Array:
    """Return the center of mass (3,), m, of the grasped object with its soft parts, frame W."""
    parts = object_bodies(world) if bodies is None else bodies
    mass = world.model.body_mass[parts]
    return mass @ world.data.xipos[parts] / mass.sum()


def object_pose(world: World, solid: SoftSolid | None = None) -> tuple[Array, Array]:
    """Return position (3,) m and unit quaternion (4,) of the MuJoCo body `object`, frame W.

    The MuJoCo body of a soft object, a `solid`, is moved along with the solid's rigid pose.
    """
    body = world.model.body(PREFIX + "object").id
    p_WO = world.data.xpos[body].copy()
    q_WO = world.data.xquat[body].copy()
    if solid is None:
        return p_WO, q_WO
    center, R = solid.pose(world.data)
    quat = np.zeros(4)
    q_now = np.zeros(4)
    mujoco.mju_mat2Quat(quat, R.ravel())
    mujoco.mju_mulQuat(q_now, quat, q_WO)
    return center + R @ (p_WO - solid.rest_center), q_now


def gripper_position(world: GripperWorld) -> Array:
    """Return the position (3,), m, of the gripper that carries the fingers, frame W."""
    return world.data.xpos[world.start.gripper].copy()


def gripper_rotation(world: GripperWorld) -> Array:
    """Return the rotation (3, 3) of the gripper that carries the fingers, from its frame to W."""
    return world.data.xmat[world.start.gripper].reshape(3, 3).copy()


def _pose(world: World, device: AnySensor) -> tuple[Array, Array]:
    return world.data.xmat[device.body_id].reshape(3, 3), world.data.xpos[device.body_id]
