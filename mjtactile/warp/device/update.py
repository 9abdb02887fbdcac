"""Step of all membranes in all worlds of a scene: poses, equilibrium, friction, results."""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.borders import find_borders
from mjtactile.warp.device.contact import MIN_FORCE, Patch, move, remember_nodes, sum_contact
from mjtactile.warp.device.elasticity import mean_tension
from mjtactile.warp.device.equilibrium import solve
from mjtactile.warp.device.fields import Fields, Scheme
from mjtactile.warp.device.gas import Gas, Heat, after_solution, before_solution
from mjtactile.warp.device.grid import MembraneGrid
from mjtactile.warp.device.lowest_obstacle import has_thin_obstacle
from mjtactile.warp.device.node_friction import move_loads, redistribute, rub
from mjtactile.warp.device.obstacles import Geom
from mjtactile.warp.device.relaxation import synchronize
from mjtactile.warp.device.sensor_geoms import SensorGeoms, place_geom
from mjtactile.warp.device.sticking import (
    NodeLoads,
    Sticking,
    about_center,
    grip_of,
    keep_loads,
    list_held,
)

wp.set_module_options({"enable_backward": False})


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
def _follow_body(
    membrane: MembraneGrid,
    sticking: Sticking,
    sensor_geoms: SensorGeoms,
    states: States,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    finger: int,
    slot: int,
    tension: float,
    has_thin: bool,
    R_SB: wp.mat33,
    p_SB: wp.vec3,
    lane: int,
    threads: int,
) -> None:
    """Sum the contact with the body of a slot, and move its friction loads with the body."""
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


@wp.func
def _slide_bodies(
    membrane: MembraneGrid,
    sticking: Sticking,
    sensor_geoms: SensorGeoms,
    states: States,
    fields: Fields,
    f: int,
    finger: int,
    lane: int,
    threads: int,
) -> None:
    """Apply Coulomb's limit to all contacts, and write their sums. The contact with the largest
    normal force gives the slip and the center."""
    friction = states.friction[f]
    patches = states.patches
    nodes = states.nodes
    redistribute(membrane, fields, patches, sticking, nodes, friction, f, lane, threads)
    force = wp.vec3(0.0, 0.0, 0.0)
    torque = wp.vec3(0.0, 0.0, 0.0)
    area = float(0.0)
    largest = float(0.0)
    main = Patch()
    for slot in range(sensor_geoms.bodies.shape[1]):
        if sensor_geoms.bodies[finger, slot] >= 0:
            now = rub(membrane, fields, patches, sticking, nodes, friction, f, slot, lane, threads)
            force += now.force
            torque += now.torque
            area += now.area
            if now.normal > largest:
                largest = now.normal
                main = now
            synchronize()
            if lane == 0:
                patches[f, slot] = now
            synchronize()
    if lane == 0:
        for c in range(3):
            states.wrench[f, c] = force[c]
            states.wrench[f, 3 + c] = torque[c]
        states.area[f] = area
        states.slid[f] = main.slid
        states.slides[f] = main.slides
        states.center[f] = main.middle


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
        place_geom(sensor_geoms, geoms, size, geom_xpos, geom_xmat, f, world, finger, k, R, p)
    if lane == 0:
        before_solution(gas, heat, f)
    synchronize()
    solve(membrane, scheme, gas, geoms, pool, fields, f, lane, threads, modulus[f])
    tension = mean_tension(membrane, fields.u, f, lane, threads, modulus[f])
    has_thin = has_thin_obstacle(membrane, geoms, f)
    find_borders(membrane, geoms, pool, fields, sensor_geoms.slots, f, finger, lane, threads)
    list_held(membrane, fields, sticking, sensor_geoms.slots, f, finger, lane)
    if sticking.stale[f] != 0:
        keep_loads(membrane, sticking, states.nodes, f, lane, threads)
    for slot in range(sensor_geoms.bodies.shape[1]):
        body = sensor_geoms.bodies[finger, slot]
        if body >= 0:
            _follow_body(
                membrane,
                sticking,
                sensor_geoms,
                states,
                geoms,
                pool,
                fields,
                f,
                finger,
                slot,
                tension,
                has_thin,
                wp.transpose(R) @ xmat[world, body],
                wp.transpose(R) @ (xpos[world, body] - p),
                lane,
                threads,
            )
    _slide_bodies(membrane, sticking, sensor_geoms, states, fields, f, finger, lane, threads)
    remember_nodes(membrane, fields, states.before, f, lane, threads)
    if lane == 0:
        after_solution(gas, heat, f, fields.pressure[f], fields.volume[f])
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
