"""Commands and observations of a policy in all worlds, as `mjtactile.core.policy`."""

from __future__ import annotations

import warp as wp

from mjtactile.core import policy
from mjtactile.warp.device.gripper import (
    Drive,
    Goals,
    closing_force,
    height_of,
    opening_of,
    opening_speed_of,
)
from mjtactile.warp.device.sensing_errors import Estimates

wp.set_module_options({"enable_backward": False})

# numbers of the phases: those of `policy.PHASES`, then the two ends
APPROACH = wp.constant(0)
CLOSE = wp.constant(1)
REGULATE = wp.constant(2)
LIFT = wp.constant(3)
HOLD = wp.constant(4)
LOWER = wp.constant(5)
RELEASE = wp.constant(6)
DONE = wp.constant(7)
ABORT = wp.constant(8)
NAMES = (*policy.PHASES, "done", "abort")

_OPENING_SPEED = wp.constant(policy.OPENING_SPEED)
_FORCE_LIMIT = wp.constant(policy.FORCE_LIMIT)
_LIFT_SPEED = wp.constant(policy.LIFT_SPEED)
_RISEN = wp.constant(policy.RISEN)
_NEAR = wp.constant(policy.NEAR)
_DOWN = wp.constant(policy.DOWN)
_CLEAR = wp.constant(policy.CLEAR)
_LEAD = wp.constant(policy.LEAD)
_TIME_MAX = wp.constant(policy.TIME_MAX)
_LOST_TIME = wp.constant(policy.LOST_TIME)
OWN = 8  # entries of a finger in the observation
_OWN = wp.constant(OWN)


@wp.struct
class TaskLimits:
    """Goal of the task and limits of the rig: heights m, times s, speeds m/s, force N.

    `handover` is 1 if the object will be taken out of the gripper.
    """

    lift_height: float
    hold_time: float
    handover: int
    opening_min: float
    opening_max: float
    speed: float
    force: float
    lift_max: float
    lift_speed: float
    period: float


@wp.struct
class Commands:
    """Last command of each world, with the memory of `command_from_action`; measured gripper.

    `force` is negative before the first command. `measured` (worlds, 4): opening m, its speed m/s,
    closing force N, height m. `play` is the part of the play, m, by which the reported opening
    differs. `noise` is the standard deviation of the reported force, N.
    """

    opening: wp.array(dtype=float)
    force: wp.array(dtype=float)
    lift: wp.array(dtype=float)
    phase: wp.array(dtype=int)
    phase_time: wp.array(dtype=float)
    lost_time: wp.array(dtype=float)
    gone: wp.array(dtype=int)
    grip_opening: wp.array(dtype=float)
    measured: wp.array2d(dtype=float)
    delay: wp.array(dtype=float)
    jitter: wp.array(dtype=float)
    noise: wp.array(dtype=float)
    random: wp.array(dtype=wp.uint32)


@wp.func
def _touches(estimates: Estimates, world: int, fingers: int) -> int:
    """Return the number of fingers that touch."""
    count = int(0)
    for k in range(fingers):
        count += estimates.touching[world * fingers + k]
    return count


@wp.func
def _next_phase(
    limits: TaskLimits,
    phase: int,
    touches: int,
    fingers: int,
    height: float,
    opening: float,
    commanded: float,
    grip: float,
    time: float,
) -> int:
    found = int(phase)
    if phase <= REGULATE:
        if height > _RISEN:
            found = LIFT
        elif touches == fingers:
            found = REGULATE
        elif touches > 0:
            found = CLOSE
        else:
            found = APPROACH
    elif phase == LIFT:
        if height > limits.lift_height - _NEAR:
            found = HOLD
    elif phase == HOLD:
        if limits.handover != 0:
            if touches == 0 or commanded > grip + _NEAR:
                found = RELEASE
        elif time >= limits.hold_time:
            found = LOWER
    elif phase == LOWER:
        if height < _DOWN or commanded > grip + _NEAR:
            found = RELEASE
    elif phase == RELEASE:
        if touches == 0 and opening > grip + _CLEAR:
            found = DONE
    return found


@wp.func
def _within(value: float, before: float, step: float, low: float, high: float) -> float:
    return wp.clamp(wp.clamp(value, before - step, before + step), low, high)


@wp.kernel
def command_all(
    limits: TaskLimits,
    fingers: int,
    actions: wp.array2d(dtype=float),
    estimates: Estimates,
    commands: Commands,
    goals: Goals,
    time: wp.array(dtype=float),
):
    """Convert each world's action to its command, which takes effect one period later."""
    world = wp.tid()
    action = wp.vec3(0.0, 0.0, 0.0)
    for k in range(3):
        if wp.isfinite(actions[world, k]):
            action[k] = wp.clamp(actions[world, k], -1.0, 1.0)
    opening = commands.measured[world, 0]
    height = commands.measured[world, 3]
    requested = commands.opening[world] + _OPENING_SPEED * action[0] * limits.period
    requested = wp.max(wp.clamp(requested, opening - _LEAD, opening + _LEAD), 0.0)
    lift = commands.lift[world] + _LIFT_SPEED * action[2] * limits.period
    lift = wp.clamp(lift, 0.0, limits.lift_height)
    force = _FORCE_LIMIT * (action[1] + 1.0) / 2.0
    # the phase of the grasp, and the time in it
    touches = _touches(estimates, world, fingers)
    before = commands.phase[world]
    lost = float(0.0)
    if touches == 0:
        lost = commands.lost_time[world] + limits.period
    in_phase = commands.phase_time[world] + limits.period
    grip = commands.grip_opening[world]
    phase = int(before)
    if (before == LIFT or before == HOLD) and lost > _LOST_TIME:
        phase = LOWER
    else:
        last_opening = commands.opening[world]
        phase = _next_phase(
            limits, before, touches, fingers, height, opening, last_opening, grip, in_phase
        )
    if phase != before:
        in_phase = 0.0
    if phase < RELEASE:
        if phase == before and (phase == LOWER or (phase == HOLD and limits.handover != 0)):
            opening = wp.min(grip, opening)
        commands.grip_opening[world] = opening
    if phase == LOWER and lost > _LOST_TIME:
        commands.gone[world] = 1
    if phase == DONE and commands.gone[world] != 0:
        phase = ABORT
    commands.phase[world] = phase
    commands.phase_time[world] = in_phase
    commands.lost_time[world] = lost
    # an unknown force allows opening and lowering only
    known = int(1)
    for k in range(fingers):
        known = known * estimates.known[world * fingers + k]
    if known == 0:
        requested = wp.max(requested, commands.opening[world])
        lift = wp.min(lift, commands.lift[world])
        if commands.force[world] >= 0.0:
            force = commands.force[world]
    last = commands.opening[world]
    step = limits.speed * limits.period
    requested = _within(requested, last, step, limits.opening_min, limits.opening_max)
    lift_step = limits.lift_speed * limits.period
    lift = _within(lift, commands.lift[world], lift_step, 0.0, limits.lift_max)
    force = wp.clamp(force, 0.0, limits.force)
    commands.opening[world] = requested
    commands.force[world] = force
    commands.lift[world] = lift
    state = commands.random[world]
    late = commands.delay[world] + commands.jitter[world] * wp.randf(state)
    commands.random[world] = state
    goals.sent[world] = goals.next[world]
    goals.due[world] = goals.next_due[world]
    goals.next[world] = wp.vec3(requested, force, lift)
    goals.next_due[world] = time[world] + limits.period + late


@wp.func
def measure(
    drive: Drive,
    goals: Goals,
    commands: Commands,
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    actuator_force: wp.array2d(dtype=float),
    world: int,
) -> None:
    """Measure the gripper; its servos report the position of the motor."""
    ahead = goals.motor[world] - goals.jaw[world]
    state = commands.random[world]
    commands.measured[world, 0] = opening_of(drive, qpos, world) + ahead
    commands.measured[world, 1] = opening_speed_of(drive, qvel, world)
    force = closing_force(drive, actuator_force, world)
    commands.measured[world, 2] = force + commands.noise[world] * wp.randn(state)
    commands.measured[world, 3] = height_of(drive, qpos, world)
    commands.random[world] = state


@wp.kernel
def measure_all(
    drive: Drive,
    goals: Goals,
    commands: Commands,
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    actuator_force: wp.array2d(dtype=float),
):
    measure(drive, goals, commands, qpos, qvel, actuator_force, wp.tid())


@wp.kernel
def observe_all(
    fingers: int,
    maximum: wp.array(dtype=float),
    estimates: Estimates,
    commands: Commands,
    observation: wp.array2d(dtype=float),
):
    """Write the observation vectors of `policy_observation`."""
    world = wp.tid()
    for k in range(fingers):
        f = world * fingers + k
        at = _OWN * k
        observation[world, at] = float(estimates.known[f])
        observation[world, at + 1] = float(estimates.touching[f])
        observation[world, at + 2] = -estimates.wrench[f, 2]
        observation[world, at + 3] = estimates.wrench[f, 0]
        observation[world, at + 4] = estimates.wrench[f, 1]
        for c in range(3):
            observation[world, at + 5 + c] = estimates.wrench[f, 3 + c]
    at = _OWN * fingers
    for k in range(4):
        observation[world, at + k] = commands.measured[world, k]
    observation[world, at + 4] = commands.opening[world] - commands.measured[world, 0]
    observation[world, at + 5] = wp.max(commands.force[world], 0.0)
    observation[world, at + 6] = wp.min(commands.phase_time[world], _TIME_MAX)
    phase = commands.phase[world]
    if phase > 6:
        phase = 0
    for k in range(7):
        observation[world, at + 7 + k] = 0.0
    observation[world, at + 7 + phase] = 1.0
    for k in range(observation.shape[1]):
        observation[world, k] = wp.clamp(observation[world, k], -maximum[k], maximum[k])
