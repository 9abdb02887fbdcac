"""Slip-aware grasp: grip as gently as the object lets, and harder as soon as it slips or is about
to.

Closes to a quarter of a newton, then lifts; the force that each finger should feel grows with what
is said of slip, within a limit, and never shrinks while the object is held. The hand waits while it
grips harder. `step` is pure: what it must remember it writes into `Command.memory` and finds again
in `Observation.command.memory`.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.grasp_estimation import shear, support
from mjtactile.types import Command, Observation

# N on each finger: what it begins with, and what it never asks for more of
FIRST_FORCE = 0.25
FORCE_MAX = 1.6
# of the force felt, and N: how much harder it grips at a slip
SLIPPING_FRACTION = 0.3
SLIPPING_STEP = 0.1
SLIP_PAUSE = 0.15  # s until a slip that goes on counts again: what the grip needs to follow
INCIPIENT_RATE = 0.6  # N/s while slip is about to begin
KICK = 0.001  # m that the jaws close at once at a slip: about 0.15 N of two soft membranes
TOUCH_FORCE = 0.08  # N: several times the noise of the estimate
SERVO_FORCE_LIMIT = 4.0  # N: the most that the servo may push, whatever is felt
# m/s
CLOSING_SPEED = 0.020
OPENING_SPEED = 0.040
# m/s for each N of error, as in gentle.py; m/s
REGULATION_GAIN = 0.03
REGULATION_SPEED_MAX = 0.010
# m/s: slow, so that slip is said before much of it
LIFT_SPEED = 0.025
# s more than lowering takes: then what is held stands already, tilted, and keeps the hand up
LOWER_TIME_SPARE = 1.0
SETTLE_TIME = 0.4
GRIP_TIMEOUT = 6.0
FORCE_TOLERANCE = 0.06  # N around the target that counts as settled
BLIND_TIME_MAX = 0.5  # s without a usable image before giving up
LOST_TIME = 0.3  # s without a touch: the object stays behind
RELEASE_OPENING = 0.012  # m to open beyond the grip before the run ends
STOP_TIME = 0.3  # s that the rig lets the jaws close no further: they are at their own stop
# N on each finger that something pushes up with while the hand goes down: what is held stands
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
    if not all(isfinite(force) for force in felt):  # unknown is not zero: stand still, then give up
        command = _remember(command, blind_time=memory["blind_time"] + period)
        blind = next(touch for touch in observation.touch if not isfinite(touch.force_normal))
        if command.memory["blind_time"] > BLIND_TIME_MAX:
            return _give_up(command, f"no force is known: {blind.status}")
        return command
    lost_time = 0.0 if max(felt) > TOUCH_FORCE else memory["lost_time"] + period
    command = _remember(command, blind_time=0.0, lost_time=lost_time)
    if command.phase in ("lift", "hold", "lower"):
        if lost_time > LOST_TIME:
            command = replace(command, reason="what was gripped stayed behind")
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
    """Raise the target for what any finger says of slip; at a slip also close at once."""
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
    # it has what it asked for, and needs more
    if "incipient" in states and max(felt) > memory["target"] - FORCE_TOLERANCE:
        return _remember(
            command, target=min(FORCE_MAX, memory["target"] + INCIPIENT_RATE * observation.period)
        )
    return command


def _regulated(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Move the opening so that the mean felt force goes to the target; stay within reach of the
    real opening."""
    error = command.memory["target"] - sum(felt) / len(felt)
    speed = max(-REGULATION_SPEED_MAX, min(REGULATION_SPEED_MAX, REGULATION_GAIN * error))
    actual = observation.gripper.opening
    opening = command.opening - speed * observation.period
    return replace(command, opening=max(actual - 0.004, min(actual + 0.004, opening)))


def _approach(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Close at a steady speed until either finger feels something, slower until both do."""
    if min(felt) > TOUCH_FORCE or max(felt) > command.memory["target"]:
        return _go(command, "regulate")
    # what was sent is what the rig allows
    gets_on = command.opening < command.memory["narrowest"] - 1e-4
    stuck_time = 0.0 if gets_on else command.memory["stuck_time"] + observation.period
    narrowest = min(command.opening, command.memory["narrowest"])
    command = _remember(command, stuck_time=stuck_time, narrowest=narrowest)
    if stuck_time > STOP_TIME:
        return _give_up(command, "closed on nothing")
    if command.phase == "close" and command.memory["phase_time"] > GRIP_TIMEOUT:
        return _give_up(command, "only one finger touched it")
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
    if observation.gripper.lift_height > observation.told.lift_height - 0.001:
        return _go(command, "hold")
    return replace(
        command,
        lift_height=min(
            observation.told.lift_height, command.lift_height + LIFT_SPEED * observation.period
        ),
    )


def _hold(observation: Observation, command: Command, felt: list[float]) -> Command:
    command = _regulated(observation, command, felt)
    command = _remember(command, held=shear(observation.touch).tolist())
    return (
        _go(command, "lower")
        if command.memory["phase_time"] >= observation.told.hold_time
        else command
    )


def _lower(observation: Observation, command: Command, felt: list[float]) -> Command:
    command = _regulated(observation, command, felt)
    goal = observation.told.place_height
    height = max(goal, command.lift_height - LIFT_SPEED * observation.period)
    command = replace(command, lift_height=height)
    # what slid down in the grip stands before the hand is down: no further, onto its edge
    held = command.memory.get("held", shear(observation.touch))
    if support(observation.touch, held) > TABLE_FORCE:
        return _remember(_go(command, "release"), grip_opening=command.opening)
    time_max = (observation.told.lift_height - goal) / LIFT_SPEED + LOWER_TIME_SPARE
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
        return _give_up(command, "it sticks to a finger")
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
