"""Forces of membranes on a scene's degrees of freedom, and damping of the bodies they hold.

The rules of kernels/qs_joint_forces.c, for one world per thread.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.contact import Patch, held_motion, normal_stiffness, patch_stiffness
from mjtactile.warp.device.fields import Fields, Gas
from mjtactile.warp.device.grid import MembraneGrid
from mjtactile.warp.device.update import SensorGeoms

wp.set_module_options({"enable_backward": False})

_SHARE = wp.constant(0.75)  # fraction of stiffness times step that damps a free body
# stiffness of parts of one object side by side, over that of a part alone (qs_joint_forces.c)
_SIDE_BY_SIDE = wp.constant(16.0)
_FREE, _BALL, _SLIDE = wp.constant(0), wp.constant(1), wp.constant(2)  # joint types of MuJoCo


@wp.struct
class Joints:
    """Kinematic tree of a model, and the damping of its degrees of freedom.

    `free` (bodies,) is the MuJoCo body whose free joint carries a body, or -1. `inertia` (1 or
    worlds, nv) is the diagonal of the mass matrix. `own` is the model's damping, `damping`
    (worlds, nv) that of the present step.
    """

    parent: wp.array(dtype=int)
    count: wp.array(dtype=int)
    first: wp.array(dtype=int)
    kind: wp.array(dtype=int)
    dof: wp.array(dtype=int)
    free: wp.array(dtype=int)
    inertia: wp.array2d(dtype=float)
    own: wp.array(dtype=float)
    damping: wp.array2d(dtype=float)


@wp.struct
class Stiffness:
    """Numbers of the stiffness against indentation: half width, m, and dV/dp, m^3/Pa."""

    half: float
    bulge: float


@wp.func
def _stiffness_of(
    stiffness: Stiffness,
    gas: Gas,
    fields: Fields,
    f: int,
    patch: Patch,
    spacing: float,
    tension: float,
) -> wp.spatial_vector:
    """Return the stiffness of a contact along and about the axes of S."""
    gas_stiffness = float(0.0)
    if gas.sealed[f] != 0:
        absolute = fields.pressure[f] + gas.ambient
        gas_stiffness = gas.exponent * absolute / (gas.flat + fields.volume[f])
    normal = normal_stiffness(
        tension, gas_stiffness, stiffness.bulge, stiffness.half, spacing, patch.area
    )
    return patch_stiffness(patch, normal, spacing)


@wp.func
def _apply(
    joints: Joints,
    xpos: wp.array2d(dtype=wp.vec3),
    xmat: wp.array2d(dtype=wp.mat33),
    xanchor: wp.array2d(dtype=wp.vec3),
    xaxis: wp.array2d(dtype=wp.vec3),
    world: int,
    start: int,
    force: wp.vec3,
    torque: wp.vec3,
    at: wp.vec3,
    out: wp.array2d(dtype=float),
) -> None:
    """Add the generalized force of a force and a torque, world frame, on a body at a point."""
    body = start
    while body > 0:
        for n in range(joints.count[body]):
            j = joints.first[body] + n
            dof = joints.dof[j]
            kind = joints.kind[j]
            origin = xanchor[world, j]
            if kind == _FREE:
                origin = xpos[world, body]
                for c in range(3):
                    out[world, dof + c] = out[world, dof + c] + force[c]
                dof += 3
            torque_k = wp.cross(at - origin, force) + torque
            if kind == _FREE or kind == _BALL:
                local = wp.transpose(xmat[world, body]) @ torque_k
                for c in range(3):
                    out[world, dof + c] = out[world, dof + c] + local[c]
            elif kind == _SLIDE:
                out[world, dof] = out[world, dof] + wp.dot(xaxis[world, j], force)
            else:
                out[world, dof] = out[world, dof] + wp.dot(xaxis[world, j], torque_k)
        body = joints.parent[body]


@wp.func
def _resist(
    joints: Joints,
    xmat: wp.array2d(dtype=wp.mat33),
    xanchor: wp.array2d(dtype=wp.vec3),
    xaxis: wp.array2d(dtype=wp.vec3),
    world: int,
    start: int,
    carried: int,
    stiffness: wp.spatial_vector,
    R: wp.mat33,
    at: wp.vec3,
    fraction: float,
    qvel: wp.array2d(dtype=float),
    qfrc_passive: wp.array2d(dtype=float),
) -> None:
    """Damp the joint axes between a body in contact and the body `carried` with the free joint.

    These joints move parts of an object against each other. `fraction` times the stiffness along an
    axis is its damping.
    """
    Rt = wp.transpose(R)
    body = start
    while body > 0 and body != carried:
        for n in range(joints.count[body]):
            j = joints.first[body] + n
            axes = int(1)
            if joints.kind[j] == _BALL:
                axes = 3
            for c in range(axes):
                axis = xaxis[world, j]
                if axes == 3:
                    R_WB = xmat[world, body]
                    axis = wp.vec3(R_WB[0, c], R_WB[1, c], R_WB[2, c])
                along = Rt @ axis
                about = wp.vec3(0.0, 0.0, 0.0)
                if joints.kind[j] != _SLIDE:
                    about = along
                    along = Rt @ wp.cross(axis, at - xanchor[world, j])
                damping = float(0.0)
                for k in range(3):
                    damping += stiffness[k] * along[k] * along[k]
                    damping += stiffness[3 + k] * about[k] * about[k]
                damping *= fraction
                dof = joints.dof[j] + c
                joints.damping[world, dof] = joints.damping[world, dof] + damping
                qfrc_passive[world, dof] = qfrc_passive[world, dof] - damping * qvel[world, dof]
        body = joints.parent[body]


@wp.func
def _held_body(
    joints: Joints, sensor_geoms: SensorGeoms, patch: Patch, finger: int, slot: int
) -> int:
    """Return the body whose free joint carries the body of a slot in contact, or -1."""
    found = int(-1)
    if sensor_geoms.bodies[finger, slot] >= 0:
        if patch.touches != 0:
            found = joints.free[sensor_geoms.bodies[finger, slot]]
    return found


@wp.func
def _write_outputs(
    sensor_geoms: SensorGeoms,
    patches: wp.array2d(dtype=Patch),
    wrench: wp.array2d(dtype=float),
    fields: Fields,
    world: int,
    sensordata: wp.array2d(dtype=float),
) -> None:
    """Write the values of the scene's `user` sensors: wrench, pressure, touching."""
    fingers = sensor_geoms.frames.shape[0]
    for finger in range(fingers):
        f = world * fingers + finger
        if sensor_geoms.outputs[finger, 0] >= 0:
            for c in range(6):
                sensordata[world, sensor_geoms.outputs[finger, 0] + c] = wrench[f, c]
        if sensor_geoms.outputs[finger, 1] >= 0:
            sensordata[world, sensor_geoms.outputs[finger, 1]] = fields.pressure[f]
        if sensor_geoms.outputs[finger, 2] >= 0:
            touches = float(0.0)
            for slot in range(sensor_geoms.bodies.shape[1]):
                if patches[f, slot].touches != 0:
                    touches = 1.0
            sensordata[world, sensor_geoms.outputs[finger, 2]] = touches


@wp.kernel
def add_forces(
    membrane: MembraneGrid,
    gas: Gas,
    stiffness: Stiffness,
    fields: Fields,
    sensor_geoms: SensorGeoms,
    joints: Joints,
    patches: wp.array2d(dtype=Patch),
    timestep: wp.array(dtype=float),
    xpos: wp.array2d(dtype=wp.vec3),
    xmat: wp.array2d(dtype=wp.mat33),
    xanchor: wp.array2d(dtype=wp.vec3),
    xaxis: wp.array2d(dtype=wp.vec3),
    qvel: wp.array2d(dtype=float),
    wrench: wp.array2d(dtype=float),
    tension: wp.array(dtype=float),
    qfrc_passive: wp.array2d(dtype=float),
    sensordata: wp.array2d(dtype=float),
):
    world = wp.tid()
    _write_outputs(sensor_geoms, patches, wrench, fields, world, sensordata)
    fingers = sensor_geoms.frames.shape[0]
    slots = sensor_geoms.bodies.shape[1]
    step = timestep[world % timestep.shape[0]]
    nv = qvel.shape[1]
    spacing = wp.min(membrane.dx, membrane.dy)
    # passive forces have the damping of the last step
    for dof in range(nv):
        extra = joints.damping[world, dof] - joints.own[dof]
        qfrc_passive[world, dof] = qfrc_passive[world, dof] + extra * qvel[world, dof]
        joints.damping[world, dof] = joints.own[dof]
    for a in range(fingers * slots):
        finger = a // slots
        slot = a - slots * finger
        f = world * fingers + finger
        patch = patches[f, slot]
        body = sensor_geoms.bodies[finger, slot]
        if body >= 0:
            if patch.touches != 0:
                frame = sensor_geoms.frames[finger]
                R = xmat[world, frame]
                force = R @ patch.force
                about = R @ (patch.torque - wp.cross(patch.middle, patch.force))
                at = xpos[world, frame] + R @ patch.middle
                _apply(
                    joints, xpos, xmat, xanchor, xaxis, world, frame, force, about, at, qfrc_passive
                )
                _apply(
                    joints,
                    xpos,
                    xmat,
                    xanchor,
                    xaxis,
                    world,
                    body,
                    -force,
                    -about,
                    at,
                    qfrc_passive,
                )
                carried = joints.free[body]
                if carried > 0 and carried != body:
                    parts = int(0)
                    for other in range(slots):
                        near = patches[f, other]
                        if _held_body(joints, sensor_geoms, near, finger, other) == carried:
                            parts += 1
                    fraction = _SHARE * step
                    if parts > 1:
                        fraction *= _SIDE_BY_SIDE
                    K_contact = _stiffness_of(stiffness, gas, fields, f, patch, spacing, tension[f])
                    _resist(
                        joints,
                        xmat,
                        xanchor,
                        xaxis,
                        world,
                        body,
                        carried,
                        K_contact,
                        R,
                        at,
                        fraction,
                        qvel,
                        qfrc_passive,
                    )
    for a in range(fingers * slots):
        body = _held_body(
            joints,
            sensor_geoms,
            patches[world * fingers + a // slots, a % slots],
            a // slots,
            a % slots,
        )
        is_first = body >= 0
        for b in range(a):
            other = _held_body(
                joints,
                sensor_geoms,
                patches[world * fingers + b // slots, b % slots],
                b // slots,
                b % slots,
            )
            if other == body:
                is_first = False
        if is_first:
            K = wp.spatial_matrix()
            against = wp.spatial_vector()
            count = float(0.0)
            for b in range(a, fingers * slots):
                finger = b // slots
                f = world * fingers + finger
                patch = patches[f, b - slots * finger]
                if _held_body(joints, sensor_geoms, patch, finger, b - slots * finger) == body:
                    frame = sensor_geoms.frames[finger]
                    R = xmat[world, frame]
                    R_SB = wp.transpose(R) @ xmat[world, body]
                    p_SB = wp.transpose(R) @ (xpos[world, body] - xpos[world, frame])
                    K_contact = _stiffness_of(stiffness, gas, fields, f, patch, spacing, tension[f])
                    K += held_motion(patch, K_contact, R, R_SB, p_SB)
                    # the free joint's body may lie off the body in contact, which turns with it
                    moved = R @ (patch.moved + wp.cross(patch.turned, p_SB - patch.p))
                    turned = wp.transpose(R_SB) @ patch.turned
                    against += wp.spatial_vector(moved, turned)
                    count += 1.0
            dof = joints.dof[joints.first[body]]
            row = world % joints.inertia.shape[0]
            against = against / (count * step)
            for r in range(6):
                total = float(0.0)
                for c in range(6):
                    total += wp.abs(K[r, c]) / wp.sqrt(joints.inertia[row, dof + c])
                total *= _SHARE * step * wp.sqrt(joints.inertia[row, dof + r])
                joints.damping[world, dof + r] = joints.damping[world, dof + r] + total
                # MuJoCo subtracts damping times velocity in its implicit step only
                qfrc_passive[world, dof + r] = qfrc_passive[world, dof + r] - total * against[r]
