"""Gentle grasp: close until touch, regulate the measured force, lift, hold, place, release.

`step` is pure: it writes its memory into `Command.memory` and reads it back from
`Observation.command.memory`. It uses no clock, simulator or device, so the same file drives the
simulated, the emulated and the real gripper. Copy it to make your own controller: any file with a
function `step(observation) -> command` works.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.grasp_estimation import phases
from mjtactile.types import Command, Observation

# target force per finger, N: enough friction for 60 g at a coefficient of 0.5, well below the
# strength of an egg
TARGET_FORCE = 0.6
TOUCH_FORCE = 0.08  # touch threshold, N: several times the noise of the estimate
SERVO_FORCE_LIMIT = 4.0  # maximum force of the servo, N, at any measured force
# closing speed before touch, m/s: 0.8 mm per cycle at 30 Hz, about 0.1 N past the first touch
CLOSING_SPEED = 0.025
OPENING_SPEED = 0.040
# opening speed per force error, m/s per N: settles in 0.2 s at a grip stiffness of 160 N/m, six
# times the delay
REGULATION_GAIN = 0.03
REGULATION_SPEED_MAX = 0.010
LIFT_SPEED = 0.040
SETTLE_TIME = 0.4
GRIP_TIMEOUT = 6.0
FORCE_TOLERANCE = 0.08  # tolerance around the target for a settled force, N
BLIND_TIME_MAX = 0.5  # maximum time without a usable image, s
# limits for a lost object: time without touch, s, or slip distance at every finger, m
LOST_TIME = 0.3
LOST_SLIP = 0.005
# lag of the jaws, m, that indicates an object between them outside the membranes
BLOCKED = 0.015
STOP_TIME = 0.3  # time, s, without further closing by the rig: the jaws are at their stop
# upward force per finger during lowering, N, that indicates a standing object
TABLE_FORCE = 0.1
RELEASE_OPENING = 0.012  # opening beyond the grip at the end of a run, m
START: dict[str, float] = dict.fromkeys(
    ("phase_time", "settled_time", "blind_time", "lost_time", "stuck_time"), 0.0
)


def step(observation: Observation) -> Command:
    """One control cycle: dispatch on the phase that the last command was in."""
    command = phases.start_cycle(observation, START, SERVO_FORCE_LIMIT)
    command = phases.update_contact_clocks(observation, command, TOUCH_FORCE, BLIND_TIME_MAX)
    forces = [touch.force_normal for touch in observation.touch]
    if not all(isfinite(force) for force in forces):
        return command
    if command.phase in ("lift", "hold", "lower") and _is_lost(observation, command):
        # release at this height, not down onto the fallen object
        command = replace(command, reason="the object slipped out of the grasp")
        return phases.start_release(command, lost=1.0)
    if command.phase not in _PHASES:  # "done" or "abort"
        return command
    return _PHASES[command.phase](observation, command, forces)


def _is_lost(observation: Observation, command: Command) -> bool:
    """Return True if the grasped object is no longer held: too heavy, too slippery."""
    slips = [touch.slip.distance if touch.slip is not None else 0.0 for touch in observation.touch]
    return command.memory["lost_time"] > LOST_TIME or min(slips) > LOST_SLIP


def _approach(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Close at a constant speed until either finger measures a force."""
    if max(forces) > TOUCH_FORCE:
        return phases.enter_phase(command, "close")
    command = phases.update_stuck_clock(observation, command, STOP_TIME)
    if command.phase == "abort":
        return command
    actual = observation.gripper.opening
    if actual - command.opening > BLOCKED:
        command = replace(command, opening=actual)
        return phases.abort(command, "an obstacle outside the membranes blocks the jaws")
    return replace(command, opening=command.opening - CLOSING_SPEED * observation.period)


def _close(observation: Observation, command: Command, forces: list[float]) -> Command:
    """One finger has touched: go on slowly until both do, so that neither pushes the object
    over."""
    if min(forces) > TOUCH_FORCE or max(forces) > TARGET_FORCE:
        return phases.enter_phase(command, "regulate")
    if command.memory["phase_time"] > GRIP_TIMEOUT:
        return phases.abort(command, "only one finger touches the object")
    return replace(command, opening=command.opening - 0.3 * CLOSING_SPEED * observation.period)


def _regulated(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Move the opening so that the mean measured force reaches the target.

    The command stays close to the actual opening.
    """
    error = TARGET_FORCE - sum(forces) / len(forces)
    speed = max(-REGULATION_SPEED_MAX, min(REGULATION_SPEED_MAX, REGULATION_GAIN * error))
    opening = command.opening - speed * observation.period
    actual = observation.gripper.opening
    return replace(command, opening=max(actual - 0.004, min(actual + 0.004, opening)))


def _regulate(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Bring the force to the target and wait until it stays there."""
    command = _regulated(observation, command, forces)
    is_settled = abs(sum(forces) / len(forces) - TARGET_FORCE) < FORCE_TOLERANCE
    return phases.settle(
        observation, command, is_settled, settle_time=SETTLE_TIME, timeout=GRIP_TIMEOUT
    )


def _lift(observation: Observation, command: Command, forces: list[float]) -> Command:
    command = _regulated(observation, command, forces)
    goal = observation.goal.lift_height
    height = min(goal, command.lift_height + LIFT_SPEED * observation.period)
    command = replace(command, lift_height=height)
    is_up = observation.gripper.lift_height > goal - 0.001
    return phases.enter_phase(command, "hold") if is_up else command


def _hold(observation: Observation, command: Command, forces: list[float]) -> Command:
    return phases.hold(observation, _regulated(observation, command, forces))


def _lower(observation: Observation, command: Command, forces: list[float]) -> Command:
    command = _regulated(observation, command, forces)
    return phases.lower(observation, command, speed=LIFT_SPEED, table_force=TABLE_FORCE)


def _release(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Open until the fingers are clear of the object."""
    return phases.release(
        observation,
        command,
        speed=OPENING_SPEED,
        clearance=RELEASE_OPENING,
        contact_force=TOUCH_FORCE,
        timeout=GRIP_TIMEOUT,
    )


_PHASES = {
    "approach": _approach,
    "close": _close,
    "regulate": _regulate,
    "lift": _lift,
    "hold": _hold,
    "lower": _lower,
    "release": _release,
}
