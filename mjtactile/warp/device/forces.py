"""Forces of membranes on a scene's degrees of freedom, and damping of the bodies they hold.

The rules of kernels/qs_joint_forces.c, for one world per thread.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.contact import Patch, held_motion, normal_stiffness, patch_stiffness
from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.gas import Gas
from mjtactile.warp.device.joints import Joints, Motion, add_force, damp_parts
from mjtactile.warp.device.sensor_geoms import SensorGeoms

wp.set_module_options({"enable_backward": False})

_SHARE = wp.constant(0.75)  # fraction of stiffness times step that damps a free body
# stiffness of parts of one object side by side, over that of a part alone (qs_joint_forces.c)
_SIDE_BY_SIDE = wp.constant(16.0)


@wp.struct
class Contacts:
    """Contacts of all membranes, and the numbers of their stiffness against indentation.

    `half` m is half the membrane's width, `bulge` m^3/Pa is dV/dp, `spacing` m that of the nodes.
    """

    geoms: SensorGeoms
    patches: wp.array2d(dtype=Patch)
    wrench: wp.array2d(dtype=float)
    tension: wp.array(dtype=float)
    fields: Fields
    gas: Gas
    half: float
    bulge: float
    spacing: float


@wp.func
def _stiffness_of(contacts: Contacts, f: int, patch: Patch) -> wp.spatial_vector:
    """Return the stiffness of a contact along and about the axes of S."""
    gas = contacts.gas
    gas_stiffness = float(0.0)
    if gas.sealed[f] != 0:
        absolute = contacts.fields.pressure[f] + gas.ambient
        gas_stiffness = gas.exponent * absolute / (gas.flat + contacts.fields.volume[f])
    tension = contacts.tension[f]
    spacing = contacts.spacing
    normal = normal_stiffness(
        tension, gas_stiffness, contacts.bulge, contacts.half, spacing, patch.area
    )
    return patch_stiffness(patch, normal, spacing)


@wp.func
def _held_body(joints: Joints, contacts: Contacts, world: int, finger: int, slot: int) -> int:
    """Return the body whose free joint carries the body of a slot in contact, or -1."""
    found = int(-1)
    body = contacts.geoms.bodies[finger, slot]
    if body >= 0:
        f = world * contacts.geoms.frames.shape[0] + finger
        if contacts.patches[f, slot].touches != 0:
            found = joints.free[body]
    return found


@wp.func
def _write_outputs(contacts: Contacts, world: int, sensordata: wp.array2d(dtype=float)) -> None:
    """Write the values of the scene's `user` sensors: wrench, pressure, touching."""
    geoms = contacts.geoms
    fingers = geoms.frames.shape[0]
    for finger in range(fingers):
        f = world * fingers + finger
        if geoms.outputs[finger, 0] >= 0:
            for c in range(6):
                sensordata[world, geoms.outputs[finger, 0] + c] = contacts.wrench[f, c]
        if geoms.outputs[finger, 1] >= 0:
            sensordata[world, geoms.outputs[finger, 1]] = contacts.fields.pressure[f]
        if geoms.outputs[finger, 2] >= 0:
            touches = float(0.0)
            for slot in range(geoms.bodies.shape[1]):
                if contacts.patches[f, slot].touches != 0:
                    touches = 1.0
            sensordata[world, geoms.outputs[finger, 2]] = touches


@wp.func
def _parts_in_contact(
    joints: Joints, contacts: Contacts, world: int, finger: int, carried: int
) -> int:
    """Return the number of bodies of one object on a membrane. `carried` has the free joint."""
    parts = int(0)
    for slot in range(contacts.geoms.bodies.shape[1]):
        if _held_body(joints, contacts, world, finger, slot) == carried:
            parts += 1
    return parts


@wp.func
def _add_contact(
    joints: Joints,
    motion: Motion,
    contacts: Contacts,
    world: int,
    finger: int,
    slot: int,
    step: float,
    out: wp.array2d(dtype=float),
) -> None:
    """Add the forces of one contact on both bodies, and damp the parts of a jointed object."""
    f = world * contacts.geoms.frames.shape[0] + finger
    patch = contacts.patches[f, slot]
    body = contacts.geoms.bodies[finger, slot]
    frame = contacts.geoms.frames[finger]
    R = motion.xmat[world, frame]
    force = R @ patch.force
    torque = R @ (patch.torque - wp.cross(patch.middle, patch.force))
    at = motion.xpos[world, frame] + R @ patch.middle
    add_force(joints, motion, world, frame, force, torque, at, out)
    add_force(joints, motion, world, body, -force, -torque, at, out)
    carried = joints.free[body]
    if carried > 0 and carried != body:
        fraction = _SHARE * step
        if _parts_in_contact(joints, contacts, world, finger, carried) > 1:
            fraction *= _SIDE_BY_SIDE
        K_contact = _stiffness_of(contacts, f, patch)
        damp_parts(joints, motion, world, body, carried, K_contact, R, at, fraction, out)


@wp.func
def _first_held_body(joints: Joints, contacts: Contacts, world: int, contact: int) -> int:
    """Return the free body of a contact, or -1 if it has none or an earlier contact has the same.

    `contact` counts the slots of all fingers.
    """
    slots = contacts.geoms.bodies.shape[1]
    body = _held_body(joints, contacts, world, contact // slots, contact % slots)
    found = body
    for earlier in range(contact):
        if _held_body(joints, contacts, world, earlier // slots, earlier % slots) == body:
            found = -1
    return found


@wp.func
def _damp_held(
    joints: Joints,
    motion: Motion,
    contacts: Contacts,
    world: int,
    body: int,
    first: int,
    step: float,
    out: wp.array2d(dtype=float),
) -> None:
    """Damp a free body by the stiffness of its contacts. `first` is the first of them.

    Damping is relative to the mean motion that its contacts measured in the last step.
    """
    fingers = contacts.geoms.frames.shape[0]
    slots = contacts.geoms.bodies.shape[1]
    K = wp.spatial_matrix()
    against = wp.spatial_vector()
    count = float(0.0)
    for contact in range(first, fingers * slots):
        finger = contact // slots
        slot = contact % slots
        if _held_body(joints, contacts, world, finger, slot) == body:
            f = world * fingers + finger
            patch = contacts.patches[f, slot]
            frame = contacts.geoms.frames[finger]
            R = motion.xmat[world, frame]
            R_SB = wp.transpose(R) @ motion.xmat[world, body]
            p_SB = wp.transpose(R) @ (motion.xpos[world, body] - motion.xpos[world, frame])
            K += held_motion(patch, _stiffness_of(contacts, f, patch), R, R_SB, p_SB)
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
        out[world, dof + r] = out[world, dof + r] - total * against[r]


@wp.kernel
def add_forces(
    contacts: Contacts,
    joints: Joints,
    motion: Motion,
    timestep: wp.array(dtype=float),
    qfrc_passive: wp.array2d(dtype=float),
    sensordata: wp.array2d(dtype=float),
):
    world = wp.tid()
    _write_outputs(contacts, world, sensordata)
    step = timestep[world % timestep.shape[0]]
    # passive forces have the damping of the last step
    for dof in range(motion.qvel.shape[1]):
        extra = joints.damping[world, dof] - joints.own[dof]
        qfrc_passive[world, dof] = qfrc_passive[world, dof] + extra * motion.qvel[world, dof]
        joints.damping[world, dof] = joints.own[dof]
    slots = contacts.geoms.bodies.shape[1]
    count = contacts.geoms.frames.shape[0] * slots
    for contact in range(count):
        finger = contact // slots
        slot = contact % slots
        if contacts.geoms.bodies[finger, slot] >= 0:
            f = world * contacts.geoms.frames.shape[0] + finger
            if contacts.patches[f, slot].touches != 0:
                _add_contact(joints, motion, contacts, world, finger, slot, step, qfrc_passive)
    for contact in range(count):
        body = _first_held_body(joints, contacts, world, contact)
        if body >= 0:
            _damp_held(joints, motion, contacts, world, body, contact, step, qfrc_passive)
