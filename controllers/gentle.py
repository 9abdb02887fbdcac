"""Gentle grasp: close until touch, regulate the measured force, lift, hold, place, release.

`step` is pure: it writes its memory into `Command.memory` and reads it back from
`Observation.command.memory`. It uses no clock, simulator or device, so the same file drives the
simulated, the emulated and the real gripper. Copy it to make your own controller: any file with a
function `step(observation) -> command` works.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.grasp_estimation import shear, support_force
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
# extra time for lowering, s: then the object already stands, tilted, and supports the gripper
LOWER_TIME_SPARE = 1.0
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


def step(observation: Observation) -> Command:
    """One control cycle: dispatch on the phase that the last command was in."""
    memory = {
        "phase_time": 0.0,
        "settled_time": 0.0,
        "blind_time": 0.0,
        "lost_time": 0.0,
        "stuck_time": 0.0,
        **observation.command.memory,
    }
    memory["phase_time"] += observation.period
    felt = [touch.force_normal for touch in observation.touch]
    known = all(isfinite(force) for force in felt)
    if known:
        memory["blind_time"] = 0.0
        memory["lost_time"] = (
            0.0 if max(felt) > TOUCH_FORCE else memory["lost_time"] + observation.period
        )
    command = replace(observation.command, force_limit=SERVO_FORCE_LIMIT, memory=memory)
    if not known:  # unknown is not zero: stand still, then open gently
        return _blind(observation, command)
    if command.phase in ("lift", "hold", "lower") and _is_lost(observation, memory["lost_time"]):
        # release at this height, not down onto the fallen object
        command = replace(command, reason="the object slipped out of the grasp")
        return _remember(_go(command, "release"), grip_opening=command.opening, lost=1.0)
    return _PHASES[command.phase](observation, command, felt)


def _go(command: Command, phase: str, **changes) -> Command:
    """Enter `phase` with its clocks at zero."""
    memory = {**command.memory, "phase_time": 0.0, "settled_time": 0.0}
    return replace(command, phase=phase, memory=memory, **changes)


def _give_up(command: Command, reason: str) -> Command:
    return replace(_go(command, "abort"), reason=reason)


def _remember(command: Command, **values) -> Command:
    return replace(command, memory={**command.memory, **values})


def _blind(observation: Observation, command: Command) -> Command:
    blind_time = command.memory["blind_time"] + observation.period
    command = _remember(command, blind_time=blind_time)
    if blind_time > BLIND_TIME_MAX:
        blind = next(touch for touch in observation.touch if not isfinite(touch.force_normal))
        return _give_up(command, f"the contact force is unknown: {blind.status}")
    return command


def _is_lost(observation: Observation, lost_time: float) -> bool:
    """Return True if the grasped object is no longer held: too heavy, too slippery."""
    slips = [touch.slip.distance if touch.slip is not None else 0.0 for touch in observation.touch]
    return lost_time > LOST_TIME or min(slips) > LOST_SLIP


def _approach(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Close at a constant speed until either finger measures a force."""
    if max(felt) > TOUCH_FORCE:
        return _go(command, "close")
    # the last command is already limited by the rig
    gets_on = command.opening < command.memory.get("narrowest", 1.0) - 1e-4
    stuck_time = 0.0 if gets_on else command.memory["stuck_time"] + observation.period
    narrowest = command.opening if gets_on else command.memory["narrowest"]
    command = _remember(command, stuck_time=stuck_time, narrowest=narrowest)
    if stuck_time > STOP_TIME:
        return _give_up(command, "the jaws closed without contact")
    actual = observation.gripper.opening
    if actual - command.opening > BLOCKED:
        return _give_up(
            replace(command, opening=actual), "an obstacle outside the membranes blocks the jaws"
        )
    return replace(command, opening=command.opening - CLOSING_SPEED * observation.period)


def _close(observation: Observation, command: Command, felt: list[float]) -> Command:
    """One finger has touched: go on slowly until both do, so that neither pushes the object
    over."""
    if min(felt) > TOUCH_FORCE or max(felt) > TARGET_FORCE:
        return _go(command, "regulate")
    if command.memory["phase_time"] > GRIP_TIMEOUT:
        return _give_up(command, "only one finger touches the object")
    return replace(command, opening=command.opening - 0.3 * CLOSING_SPEED * observation.period)


def _regulated(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Move the opening so that the mean measured force reaches the target.

    The command stays close to the actual opening.
    """
    error = TARGET_FORCE - sum(felt) / len(felt)
    speed = max(-REGULATION_SPEED_MAX, min(REGULATION_SPEED_MAX, REGULATION_GAIN * error))
    opening = command.opening - speed * observation.period
    actual = observation.gripper.opening
    return replace(command, opening=max(actual - 0.004, min(actual + 0.004, opening)))


def _regulate(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Bring the force to the target and wait until it stays there."""
    command = _regulated(observation, command, felt)
    settled = abs(sum(felt) / len(felt) - TARGET_FORCE) < FORCE_TOLERANCE
    settled_time = command.memory["settled_time"] + observation.period if settled else 0.0
    if settled_time >= SETTLE_TIME:
        return _go(command, "lift")
    if command.memory["phase_time"] > GRIP_TIMEOUT:
        return _give_up(command, "the force did not settle")
    return _remember(command, settled_time=settled_time)


def _lift(observation: Observation, command: Command, felt: list[float]) -> Command:
    command = _regulated(observation, command, felt)
    height = min(
        observation.goal.lift_height, command.lift_height + LIFT_SPEED * observation.period
    )
    command = replace(command, lift_height=height)
    return (
        _go(command, "hold")
        if observation.gripper.lift_height > observation.goal.lift_height - 0.001
        else command
    )


def _hold(observation: Observation, command: Command, felt: list[float]) -> Command:
    command = _regulated(observation, command, felt)
    command = _remember(command, held=shear(observation.touch).tolist())
    return (
        _go(command, "lower")
        if command.memory["phase_time"] >= observation.goal.hold_time
        else command
    )


def _lower(observation: Observation, command: Command, felt: list[float]) -> Command:
    command = _regulated(observation, command, felt)
    goal = observation.goal.place_height
    height = max(goal, command.lift_height - LIFT_SPEED * observation.period)
    command = replace(command, lift_height=height)
    # an object that slid down in the grip reaches the table before the gripper is down; stop here,
    # else it is pressed onto its edge
    held = command.memory.get("held", shear(observation.touch))
    if support_force(observation.touch, held) > TABLE_FORCE:
        return _remember(_go(command, "release"), grip_opening=command.opening)
    time_max = (observation.goal.lift_height - goal) / LIFT_SPEED + LOWER_TIME_SPARE
    if height == goal and (
        observation.gripper.lift_height < goal + 0.001 or command.memory["phase_time"] > time_max
    ):
        return _remember(_go(command, "release"), grip_opening=command.opening)
    return command


def _release(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Open until the fingers are clear of the object."""
    goal = command.memory["grip_opening"] + RELEASE_OPENING
    if observation.gripper.opening > goal - 0.001 and max(felt) < TOUCH_FORCE:
        return _go(command, "abort" if "lost" in command.memory else "done")
    if command.memory["phase_time"] > GRIP_TIMEOUT:
        return _give_up(command, "the object sticks to a finger")
    return replace(command, opening=min(goal, command.opening + OPENING_SPEED * observation.period))


def _end(observation: Observation, command: Command, felt: list[float]) -> Command:
    return command


_PHASES = {
    "approach": _approach,
    "close": _close,
    "regulate": _regulate,
    "lift": _lift,
    "hold": _hold,
    "lower": _lower,
    "release": _release,
    "done": _end,
    "abort": _end,
}
