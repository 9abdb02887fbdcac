"""Step of all membranes in all worlds of a scene: poses, equilibrium, friction, results."""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.contact import MIN_FORCE, Patch, move, remember_nodes, sum_contact
from mjtactile.warp.device.elasticity import mean_tension
from mjtactile.warp.device.equilibrium import solve
from mjtactile.warp.device.fields import Fields, Gas, Scheme
from mjtactile.warp.device.grid import MembraneGrid
from mjtactile.warp.device.lowest_obstacle import has_thin_obstacle
from mjtactile.warp.device.node_friction import move_loads, redistribute, rub
from mjtactile.warp.device.obstacles import CONVEX, PLANE, Geom
from mjtactile.warp.device.relaxation import synchronize
from mjtactile.warp.device.sticking import (
    NodeLoads,
    Sticking,
    about_center,
    grip_of,
    keep_loads,
    list_held,
)

wp.set_module_options({"enable_backward": False})

_DEEP = 10.0  # half-extent of a plane's solid side, m


@wp.struct
class SensorGeoms:
    """Fingers of a scene and the geoms that each may touch.

    `frames` (fingers,) are the sensors' MuJoCo bodies. `geoms` (fingers, geoms) are indices in the
    model, -1 if absent, `kinds` their kinds, `slots` the numbers of their bodies among `bodies`
    (fingers, slots), 0 for the world. `mesh` (1 or worlds, geoms of the model) is the mesh of a
    geom, `first` and `count` (meshes,) its planes. `rbound` m and `box` are its bounding sphere and
    box. `radius` m is that of a membrane; `middle` and `half` m are center and half-extents of the
    chamber with its bulge. `outputs` (fingers, 3) are the addresses of wrench,
    pressure and touching in `sensordata`, -1 if absent.
    """

    frames: wp.array(dtype=int)
    geoms: wp.array2d(dtype=int)
    kinds: wp.array2d(dtype=int)
    mesh: wp.array2d(dtype=int)
    first: wp.array(dtype=int)
    count: wp.array(dtype=int)
    slots: wp.array2d(dtype=int)
    bodies: wp.array2d(dtype=int)
    rbound: wp.array2d(dtype=float)
    box: wp.array3d(dtype=wp.vec3)
    outputs: wp.array2d(dtype=int)
    radius: float
    middle: wp.vec3
    half: wp.vec3


@wp.struct
class Heat:
    """Gas of all membranes between steps (equation G4 of docs/theory).

    `amount` (F,) is n R T of the walls, J. `warmth` the gas temperature over that of the walls;
    `volume` m^3 at the last step. `supply` the gauge pressure, Pa, behind an open valve.
    `exchange` is the time step over the time constant of heat exchange.
    """

    amount: wp.array(dtype=float)
    warmth: wp.array(dtype=float)
    volume: wp.array(dtype=float)
    supply: wp.array(dtype=float)
    exchange: float
    gamma: float


@wp.func
def _ramp(x: float) -> float:
    """Return (1 - exp(-x)) / x."""
    found = float(1.0)
    if wp.abs(x) > 1.0e-4:
        found = (1.0 - wp.exp(-x)) / x
    return found


@wp.func
def before_solution(gas: Gas, heat: Heat, f: int) -> None:
    """Write the gas law of the coming step: p V^gamma with the heat lost within the step."""
    if gas.sealed[f] != 0:
        x = heat.exchange
        warmth = heat.warmth[f] * wp.exp(-x) + x * _ramp(x)
        # at constant volume. `gas.exponent` has the response to a change of volume
        absolute = heat.amount[f] * warmth / heat.volume[f]
        gas.amount[f] = absolute * wp.pow(heat.volume[f], gas.exponent)
    else:
        gas.amount[f] = heat.supply[f]


@wp.func
def after_solution(gas: Gas, heat: Heat, f: int, pressure: float, bulge: float) -> None:
    """Advance the gas to its new volume."""
    volume = gas.flat + bulge
    if gas.sealed[f] != 0:
        x = heat.exchange
        decay = (heat.gamma - 1.0) * wp.log(volume / heat.volume[f]) + x
        heat.warmth[f] = heat.warmth[f] * wp.exp(-decay) + x * _ramp(decay)
    else:
        heat.warmth[f] = 1.0
        heat.amount[f] = (pressure + gas.ambient) * volume
    heat.volume[f] = volume


@wp.struct
class States:
    """Contact memory and results of all membranes (worlds * fingers,)."""

    patches: wp.array2d(dtype=Patch)
    before: wp.array3d(dtype=float)
    nodes: NodeLoads
    friction: wp.array(dtype=float)
    wrench: wp.array2d(dtype=float)
    area: wp.array(dtype=float)
    slid: wp.array(dtype=float)
    slides: wp.array(dtype=int)
    center: wp.array(dtype=wp.vec3)
    tension: wp.array(dtype=float)


@wp.func
def _is_near(
    sensor_geoms: SensorGeoms, world: int, finger: int, k: int, g: int, at: wp.vec3, R: wp.mat33
) -> bool:
    """Return True if a geom at a pose in S may touch the membrane.

    Planes and walls that are fixed to the world have large bounding spheres.
    """
    reach = sensor_geoms.radius
    near = reach + sensor_geoms.rbound[world % sensor_geoms.rbound.shape[0], g]
    if sensor_geoms.kinds[finger, k] == PLANE:
        return _beyond(sensor_geoms, at, R, 2, -_DEEP, _DEEP) < 0.0
    found = wp.dot(at, at) < near * near
    if found and sensor_geoms.bodies[finger, sensor_geoms.slots[finger, k]] == 0:
        row = world % sensor_geoms.box.shape[0]
        middle = sensor_geoms.box[row, g, 0]
        half = sensor_geoms.box[row, g, 1]
        for axis in range(3):
            if _beyond(sensor_geoms, at, R, axis, middle[axis], half[axis]) > 0.0:
                found = False
    return found


@wp.func
def _beyond(
    sensor_geoms: SensorGeoms, at: wp.vec3, R: wp.mat33, axis: int, middle: float, half: float
) -> float:
    """Return the distance between the chamber with its bulge and a geom's bounding box along an
    axis of the geom, m."""
    normal = wp.vec3(R[0, axis], R[1, axis], R[2, axis])
    offset = wp.dot(normal, sensor_geoms.middle - at) - middle
    size = wp.dot(
        wp.vec3(wp.abs(normal[0]), wp.abs(normal[1]), wp.abs(normal[2])), sensor_geoms.half
    )
    return wp.abs(offset) - size - half


@wp.func
def _place(
    sensor_geoms: SensorGeoms,
    geoms: wp.array2d(dtype=Geom),
    size: wp.array2d(dtype=wp.vec3),
    geom_xpos: wp.array2d(dtype=wp.vec3),
    geom_xmat: wp.array2d(dtype=wp.mat33),
    f: int,
    world: int,
    finger: int,
    k: int,
    R: wp.mat33,
    p: wp.vec3,
) -> None:
    """Write one geom's pose in the sensor's frame; kind -1 if it is out of reach."""
    g = sensor_geoms.geoms[finger, k]
    geom = Geom()
    geom.kind = -1
    if g >= 0:
        at = wp.transpose(R) @ (geom_xpos[world, g] - p)
        R_SG = wp.transpose(R) @ geom_xmat[world, g]
        if _is_near(sensor_geoms, world, finger, k, g, at, R_SG):
            geom.kind = sensor_geoms.kinds[finger, k]
            geom.size = size[world % size.shape[0], g]
            geom.p = at
            geom.R = R_SG
            mesh = sensor_geoms.mesh[world % sensor_geoms.mesh.shape[0], g]
            if geom.kind == CONVEX:
                if mesh < 0:
                    geom.kind = -1
                else:
                    geom.first = sensor_geoms.first[mesh]
                    geom.count = sensor_geoms.count[mesh]
    geoms[f, k] = geom


@wp.kernel
def update_all(
    membrane: MembraneGrid,
    scheme: Scheme,
    gas: Gas,
    heat: Heat,
    sticking: Sticking,
    sensor_geoms: SensorGeoms,
    states: States,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    modulus: wp.array(dtype=float),
    fields: Fields,
    size: wp.array2d(dtype=wp.vec3),
    xpos: wp.array2d(dtype=wp.vec3),
    xmat: wp.array2d(dtype=wp.mat33),
    geom_xpos: wp.array2d(dtype=wp.vec3),
    geom_xmat: wp.array2d(dtype=wp.mat33),
    shift: wp.vec3,
    turn: wp.mat33,
):
    # all obstacles are first turned about the origin of S, then shifted along its axes
    f, lane = wp.tid()
    threads = wp.block_dim()
    fingers = sensor_geoms.frames.shape[0]
    world = f // fingers
    finger = f - fingers * world
    frame = sensor_geoms.frames[finger]
    R = xmat[world, frame] @ wp.transpose(turn)
    p = xpos[world, frame] - R @ shift
    for k in range(lane, geoms.shape[1], threads):
        _place(sensor_geoms, geoms, size, geom_xpos, geom_xmat, f, world, finger, k, R, p)
    if lane == 0:
        before_solution(gas, heat, f)
    synchronize()
    solve(membrane, scheme, gas, geoms, pool, fields, f, lane, threads, modulus[f])
    tension = mean_tension(membrane, fields.u, f, lane, threads, modulus[f])
    has_thin = has_thin_obstacle(membrane, geoms, f)
    list_held(membrane, fields, sticking, sensor_geoms.slots, f, finger, lane)
    if sticking.stale[f] != 0:
        keep_loads(membrane, sticking, states.nodes, f, lane, threads)
    force = wp.vec3(0.0, 0.0, 0.0)
    torque = wp.vec3(0.0, 0.0, 0.0)
    largest = float(0.0)
    main = Patch()
    area = float(0.0)
    for slot in range(sensor_geoms.bodies.shape[1]):
        body = sensor_geoms.bodies[finger, slot]
        if body >= 0:
            patch = sum_contact(
                membrane,
                geoms,
                pool,
                fields,
                sensor_geoms.slots,
                states.before,
                f,
                finger,
                slot,
                lane,
                threads,
                tension,
                has_thin,
            )
            R_SB = wp.transpose(R) @ xmat[world, body]
            p_SB = wp.transpose(R) @ (xpos[world, body] - p)
            last = states.patches[f, slot]
            grip = about_center(last.grip, patch.middle - last.middle)
            if patch.normal > MIN_FORCE and states.friction[f] > 0.0:
                if sticking.stale[f] != 0 or last.grip[0, 0] <= 0.0:
                    grip = grip_of(
                        membrane,
                        fields,
                        sticking,
                        sensor_geoms.slots,
                        f,
                        finger,
                        slot,
                        patch.middle,
                        lane,
                        threads,
                        states.nodes,
                    )
            now = move(grip, last, patch, R_SB, p_SB)
            move_loads(membrane, sticking, states.nodes, now.along, f, slot, lane, threads)
            synchronize()
            if lane == 0:
                states.patches[f, slot] = now
            synchronize()
    friction = states.friction[f]
    redistribute(
        membrane, fields, states.patches, sticking, states.nodes, friction, f, lane, threads
    )
    for slot in range(sensor_geoms.bodies.shape[1]):
        if sensor_geoms.bodies[finger, slot] >= 0:
            now = rub(
                membrane,
                fields,
                states.patches,
                sticking,
                states.nodes,
                friction,
                f,
                slot,
                lane,
                threads,
            )
            force += now.force
            torque += now.torque
            area += now.area
            if now.normal > largest:
                largest = now.normal
                main = now
            synchronize()
            if lane == 0:
                states.patches[f, slot] = now
            synchronize()
    remember_nodes(membrane, fields, states.before, f, lane, threads)
    if lane == 0:
        after_solution(gas, heat, f, fields.pressure[f], fields.volume[f])
        for c in range(3):
            states.wrench[f, c] = force[c]
            states.wrench[f, 3 + c] = torque[c]
        states.area[f] = area
        states.slid[f] = main.slid
        states.slides[f] = main.slides
        states.center[f] = main.middle
        states.tension[f] = tension


@wp.kernel
def reset_worlds(
    fingers: int,
    mask: wp.array(dtype=bool),
    rest: wp.array2d(dtype=float),
    pressure: float,
    volume: float,
    rest_volume: wp.array(dtype=float),
    gas: Gas,
    heat: Heat,
    fields: Fields,
    states: States,
):
    f, k = wp.tid()
    if mask[f // fingers]:
        higher = rest_volume[f] / volume
        for c in range(3):
            at = rest[c, k]
            if c == 2:
                at = higher * at
            fields.u[f, c, k] = at
            fields.kept[f, c, k] = at
            states.before[f, c, k] = 0.0
        for c in range(2):
            states.nodes.load[f, c, k] = 0.0
            states.nodes.lag[f, c, k] = 0.0
        fields.force[f, k] = 0.0
        fields.kept_force[f, k] = 0.0
        if k == 0:
            fields.pressure[f] = pressure
            fields.volume[f] = rest_volume[f]
            fields.status[f] = 0
            fields.lost[f] = 0
            fields.gain[f] = 1.0
            for c in range(6):
                states.wrench[f, c] = 0.0
            states.area[f] = 0.0
            states.slid[f] = 0.0
            states.slides[f] = 0
            gas.sealed[f] = 1
            heat.warmth[f] = 1.0
            heat.volume[f] = gas.flat + rest_volume[f]
            heat.amount[f] = (pressure + gas.ambient) * heat.volume[f]
            heat.supply[f] = pressure
            for slot in range(states.patches.shape[1]):
                states.patches[f, slot] = Patch()
