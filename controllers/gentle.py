"""Gentle grasp: close until touch, regulate the measured force, lift, hold, place, release.

`step` is pure: it writes its memory into `Command.memory` and reads it back from
`Observation.command.memory`. It uses no clock, simulator or device, so the same file drives the
simulated, the emulated and the real gripper. Copy it to make your own controller: any file with a
function `step(observation) -> command` works.
"""

from dataclasses import replace
from functools import partial

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
FORCE_TOLERANCE = 0.08  # tolerance around the target for a settled force, N
LOST_SLIP = 0.005  # slip distance at every finger, m, of a lost object
# lag of the jaws, m, that indicates an object between them outside the membranes
BLOCKED = 0.015
# upward force per finger during lowering, N, that indicates a standing object
TABLE_FORCE = 0.1


def step(observation: Observation) -> Command:
    """Run one control cycle: the function of the last command's phase."""
    return phases.run_cycle(
        observation,
        PHASES,
        start={},
        force_limit=SERVO_FORCE_LIMIT,
        contact_force=TOUCH_FORCE,
        lost_slip=LOST_SLIP,
    )


def _approach(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Close at a constant speed until either finger measures a force."""
    if max(forces) > TOUCH_FORCE:
        return phases.enter_phase(command, "close")
    command = phases.update_stuck_clock(observation, command)
    if command.phase == "abort":
        return command
    actual = observation.gripper.opening
    if actual - command.opening > BLOCKED:
        command = replace(command, opening=actual)
        return phases.abort(command, "an obstacle outside the membranes blocks the jaws")
    return replace(command, opening=command.opening - CLOSING_SPEED * observation.period)


def _close(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Close slowly after the first contact until both fingers touch, so that neither tips the
    object."""
    if min(forces) > TOUCH_FORCE or max(forces) > TARGET_FORCE:
        return phases.enter_phase(command, "regulate")
    if command.memory["phase_time"] > phases.GRIP_TIMEOUT:
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
    return phases.settle(observation, command, is_settled, SETTLE_TIME)


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


PHASES = {
    "approach": _approach,
    "close": _close,
    "regulate": _regulate,
    "lift": _lift,
    "hold": _hold,
    "lower": _lower,
    "release": partial(phases.release, speed=OPENING_SPEED, contact_force=TOUCH_FORCE),
}
