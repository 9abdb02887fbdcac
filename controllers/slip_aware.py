"""Slip-aware grasp: grip as lightly as the object permits; tighten at slip or incipient slip.

It closes to a quarter of a newton, then lifts. The target force per finger grows with the reported
slip, up to a limit. It never decreases while the object is held. The lift waits while the grip
tightens. `step` is pure: it writes its memory into `Command.memory` and reads it back from
`Observation.command.memory`.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.grasp_estimation import shear, support_force
from mjtactile.types import Command, Observation

# initial and maximum target force per finger, N
FIRST_FORCE = 0.25
FORCE_MAX = 1.6
# increase of the target at a slip: fraction of the measured force, and constant, N
SLIPPING_FRACTION = 0.3
SLIPPING_STEP = 0.1
SLIP_PAUSE = 0.15  # time, s, until a lasting slip counts again: response time of the grip
INCIPIENT_RATE = 0.6  # rate of the target during incipient slip, N/s
KICK = 0.001  # immediate closing at a slip, m: about 0.15 N for two soft membranes
TOUCH_FORCE = 0.08  # touch threshold, N: several times the noise of the estimate
SERVO_FORCE_LIMIT = 4.0  # maximum force of the servo, N, at any measured force
# speeds, m/s
CLOSING_SPEED = 0.020
OPENING_SPEED = 0.040
# gain, m/s per N of force error, as in gentle.py; speed limit, m/s
REGULATION_GAIN = 0.03
REGULATION_SPEED_MAX = 0.010
# lift speed, m/s: slow, so that slip is detected early
LIFT_SPEED = 0.025
# extra time for lowering, s: then the object already stands, tilted, and supports the gripper
LOWER_TIME_SPARE = 1.0
SETTLE_TIME = 0.4
GRIP_TIMEOUT = 6.0
FORCE_TOLERANCE = 0.06  # tolerance around the target for a settled force, N
BLIND_TIME_MAX = 0.5  # maximum time without a usable image, s
LOST_TIME = 0.3  # time without touch, s, after which the object counts as lost
RELEASE_OPENING = 0.012  # opening beyond the grip at the end of a run, m
STOP_TIME = 0.3  # time, s, without further closing by the rig: the jaws are at their stop
# upward force per finger during lowering, N, that indicates a standing object
TABLE_FORCE = 0.1
START = {
    "phase_time": 0.0,
    "settled_time": 0.0,
    "blind_time": 0.0,
    "lost_time": 0.0,
    "target": FIRST_FORCE,
    "since_slip": 1.0,
    "slips": 0.0,
    "stuck_time": 0.0,
    "narrowest": 1.0,
}


def step(observation: Observation) -> Command:
    """One control cycle: dispatch on the phase that the last command was in."""
    period = observation.period
    felt = [touch.force_normal for touch in observation.touch]
    memory = {**START, **observation.command.memory}
    memory["phase_time"] += period
    memory["since_slip"] += period
    command = replace(observation.command, force_limit=SERVO_FORCE_LIMIT, memory=memory)
    if not all(isfinite(force) for force in felt):  # an unknown force is not zero: stop, then abort
        command = _remember(command, blind_time=memory["blind_time"] + period)
        blind = next(touch for touch in observation.touch if not isfinite(touch.force_normal))
        if command.memory["blind_time"] > BLIND_TIME_MAX:
            return _give_up(command, f"the contact force is unknown: {blind.status}")
        return command
    lost_time = 0.0 if max(felt) > TOUCH_FORCE else memory["lost_time"] + period
    command = _remember(command, blind_time=0.0, lost_time=lost_time)
    if command.phase in ("lift", "hold", "lower"):
        if lost_time > LOST_TIME:
            command = replace(command, reason="the object slipped out of the grasp")
            return _remember(_go(command, "release"), grip_opening=command.opening, lost=1.0)
        command = _grip_as_needed(observation, command, felt)
    return _PHASES[command.phase](observation, command, felt)


def _go(command: Command, phase: str, **changes) -> Command:
    """Enter `phase` with its clocks at zero."""
    return replace(_remember(command, phase_time=0.0, settled_time=0.0), phase=phase, **changes)


def _give_up(command: Command, reason: str) -> Command:
    return replace(_go(command, "abort"), reason=reason)


def _remember(command: Command, **values) -> Command:
    return replace(command, memory={**command.memory, **values})


def _grip_as_needed(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Raise the target force if any finger reports slip or incipient slip; at slip also close
    immediately."""
    memory = command.memory
    states = [
        touch.slip.state if touch.slip is not None else "unknown" for touch in observation.touch
    ]
    if "slipping" in states and memory["since_slip"] >= SLIP_PAUSE:
        target = min(
            FORCE_MAX, max(memory["target"], *felt) * (1 + SLIPPING_FRACTION) + SLIPPING_STEP
        )
        kick = KICK if target > memory["target"] else 0.0
        command = replace(command, opening=command.opening - kick)
        return _remember(command, target=target, since_slip=0.0, slips=memory["slips"] + 1)
    # the target force is reached but insufficient
    if "incipient" in states and max(felt) > memory["target"] - FORCE_TOLERANCE:
        return _remember(
            command, target=min(FORCE_MAX, memory["target"] + INCIPIENT_RATE * observation.period)
        )
    return command


def _regulated(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Move the opening so that the mean measured force reaches the target.

    The command stays close to the actual opening.
    """
    error = command.memory["target"] - sum(felt) / len(felt)
    speed = max(-REGULATION_SPEED_MAX, min(REGULATION_SPEED_MAX, REGULATION_GAIN * error))
    actual = observation.gripper.opening
    opening = command.opening - speed * observation.period
    return replace(command, opening=max(actual - 0.004, min(actual + 0.004, opening)))


def _approach(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Close at a constant speed until either finger measures a force, slower until both do."""
    if min(felt) > TOUCH_FORCE or max(felt) > command.memory["target"]:
        return _go(command, "regulate")
    # the last command is already limited by the rig
    gets_on = command.opening < command.memory["narrowest"] - 1e-4
    stuck_time = 0.0 if gets_on else command.memory["stuck_time"] + observation.period
    narrowest = min(command.opening, command.memory["narrowest"])
    command = _remember(command, stuck_time=stuck_time, narrowest=narrowest)
    if stuck_time > STOP_TIME:
        return _give_up(command, "the jaws closed without contact")
    if command.phase == "close" and command.memory["phase_time"] > GRIP_TIMEOUT:
        return _give_up(command, "only one finger touches the object")
    if command.phase == "approach" and max(felt) > TOUCH_FORCE:
        return _go(command, "close")
    speed = CLOSING_SPEED if command.phase == "approach" else 0.3 * CLOSING_SPEED
    return replace(command, opening=command.opening - speed * observation.period)


def _regulate(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Bring the force to the target and wait until it stays there."""
    command = _regulated(observation, command, felt)
    settled = abs(sum(felt) / len(felt) - command.memory["target"]) < FORCE_TOLERANCE
    settled_time = command.memory["settled_time"] + observation.period if settled else 0.0
    if settled_time >= SETTLE_TIME:
        return _go(command, "lift")
    if command.memory["phase_time"] > GRIP_TIMEOUT:
        return _give_up(command, "the force did not settle")
    return _remember(command, settled_time=settled_time)


def _lift(observation: Observation, command: Command, felt: list[float]) -> Command:
    command = _regulated(observation, command, felt)
    if (
        command.memory["since_slip"] < 2 * SLIP_PAUSE
        or sum(felt) / len(felt) < command.memory["target"] - FORCE_TOLERANCE
    ):
        return command  # grip first
    if observation.gripper.lift_height > observation.goal.lift_height - 0.001:
        return _go(command, "hold")
    return replace(
        command,
        lift_height=min(
            observation.goal.lift_height, command.lift_height + LIFT_SPEED * observation.period
        ),
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
    "close": _approach,
    "regulate": _regulate,
    "lift": _lift,
    "hold": _hold,
    "lower": _lower,
    "release": _release,
    "done": _end,
    "abort": _end,
}
