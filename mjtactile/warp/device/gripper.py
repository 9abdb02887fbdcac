"""Jaws and lift of a simulated gripper in all worlds, as `mjtactile.sim.scenes.gripper_world`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Drive:
    """Linear drive, as `mjtactile.sim.batched_quasistatic_step.Drive`.

    `jaw` are actuator ids of the jaws. `forces` (worlds, actuators) are the force limits.
    `fraction` is the force on a finger per mean force of the actuators.
    """

    opening: float
    read: wp.array(dtype=int)
    velocity: wp.array(dtype=int)
    per: wp.array(dtype=float)
    controls: wp.array(dtype=int)
    affine: wp.array2d(dtype=float)
    jaws: wp.array(dtype=int)
    ratios: wp.array(dtype=float)
    forces: wp.array2d(dtype=wp.vec2)
    force_range: wp.array(dtype=wp.vec2)
    stiffness: wp.array(dtype=float)
    damping: wp.array(dtype=float)
    fraction: float
    lift_read: int
    lift_ratio: float
    lift_speed: float
    opening_max: float


@wp.struct
class Goals:
    """State of the drives (worlds,): goals and targets, m; force limit, N; command on its way.

    `motor` and `jaw` are the goals of the motor and of the gear output. `due` is the time, s, at
    which the command `sent` (opening, force limit, lift) takes effect; negative: none is on its
    way. The newest command, `next`, is due in the next period. `speed` m/s and `play` m are the
    jaws' own.
    """

    opening: wp.array(dtype=float)
    opening_target: wp.array(dtype=float)
    lift: wp.array(dtype=float)
    lift_target: wp.array(dtype=float)
    force: wp.array(dtype=float)
    motor: wp.array(dtype=float)
    jaw: wp.array(dtype=float)
    due: wp.array(dtype=float)
    sent: wp.array(dtype=wp.vec3)
    next_due: wp.array(dtype=float)
    next: wp.array(dtype=wp.vec3)
    speed: wp.array(dtype=float)
    play: wp.array(dtype=float)


@wp.func
def opening_of(drive: Drive, qpos: wp.array2d(dtype=float), world: int) -> float:
    opening = float(drive.opening)
    for k in range(drive.read.shape[0]):
        opening += drive.per[k] * qpos[world, drive.read[k]]
    return opening


@wp.func
def opening_speed_of(drive: Drive, qvel: wp.array2d(dtype=float), world: int) -> float:
    speed = float(0.0)
    for k in range(drive.read.shape[0]):
        speed += drive.per[k] * qvel[world, drive.velocity[k]]
    return speed


@wp.func
def closing_force(drive: Drive, actuator_force: wp.array2d(dtype=float), world: int) -> float:
    """Return the closing force of the servos on each finger, N."""
    force = float(0.0)
    for k in range(drive.jaws.shape[0]):
        force += actuator_force[world, drive.jaws[k]] / drive.ratios[k]
    return -drive.fraction * force / float(drive.jaws.shape[0])


@wp.func
def height_of(drive: Drive, qpos: wp.array2d(dtype=float), world: int) -> float:
    height = float(0.0)
    if drive.lift_read >= 0:
        height = qpos[world, drive.lift_read] * drive.lift_ratio
    return height


@wp.func
def _nearer(start: float, goal: float, maximum: float) -> float:
    return start + wp.clamp(goal - start, -maximum, maximum)


@wp.func
def arrive(drive: Drive, goals: Goals, world: int) -> None:
    """Apply the pending command. The jaws follow the motor after the backlash is used up."""
    sent = goals.sent[world]
    half = goals.play[world] / 2.0
    goals.motor[world] = sent[0]
    jaw = wp.max(wp.max(goals.jaw[world], sent[0] - half), 0.0)
    goals.jaw[world] = wp.min(jaw, sent[0] + half)
    goals.opening_target[world] = wp.min(goals.jaw[world], drive.opening_max)
    goals.force[world] = sent[1]
    goals.lift_target[world] = sent[2]
    limit_force(drive, world, sent[1])
    goals.due[world] = -1.0


@wp.func
def limit_force(drive: Drive, world: int, force: float) -> None:
    """Limit the force on each finger, N."""
    for k in range(drive.jaws.shape[0]):
        jaw = drive.jaws[k]
        joint_force = force / drive.fraction * wp.abs(drive.ratios[k])
        low = wp.max(-joint_force, drive.force_range[jaw][0])
        drive.forces[world, jaw] = wp.vec2(low, wp.min(joint_force, drive.force_range[jaw][1]))


@wp.kernel
def drive_grippers(
    drive: Drive,
    goals: Goals,
    timestep: float,
    time: wp.array(dtype=float),
    qpos: wp.array2d(dtype=float),
    ctrl: wp.array2d(dtype=float),
):
    """Move both goals towards their targets at limited speed and lead, for one physics step."""
    world = wp.tid()
    if goals.due[world] >= 0.0 and goals.due[world] <= time[world] + 0.5 * timestep:
        arrive(drive, goals, world)
    step = goals.speed[world] * timestep
    count = float(drive.jaws.shape[0])
    max_lead = float(1.0e6)
    for k in range(drive.jaws.shape[0]):
        slope = wp.abs(drive.ratios[k])
        limit = drive.forces[world, drive.jaws[k]][1]
        force = 1.2 * limit + drive.damping[k] * goals.speed[world] / (count * slope)
        max_lead = wp.min(max_lead, force / drive.stiffness[k] * slope * count)
    goal = _nearer(goals.opening[world], goals.opening_target[world], step)
    goal = _nearer(opening_of(drive, qpos, world), goal, max_lead + 4.0 * step)
    lift = _nearer(goals.lift[world], goals.lift_target[world], drive.lift_speed * timestep)
    goals.opening[world] = goal
    goals.lift[world] = lift
    for k in range(drive.controls.shape[0]):
        ctrl[world, drive.controls[k]] = (
            drive.affine[k, 0] + drive.affine[k, 1] * goal + drive.affine[k, 2] * lift
        )
