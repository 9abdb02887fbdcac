"""Probe: press to a small force, hold the jaws still, let go, wait, and touch once more to see what
stayed.

Pure like `gentle.py`: what it must remember is in `Command.memory`. What the object is made of is
judged from what was felt meanwhile (`mjtactile probe`); this file only moves.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.types import Command, Observation

PROBE_FORCE = 0.9  # N on each finger: a strawberry bruises at 1.2
# N of the second touch: enough to see the surface, too little to press it further
SECOND_FORCE = 0.35
TOUCH_FORCE = 0.08  # N: several times the noise of the estimate
SERVO_FORCE_LIMIT = 4.0  # N: the most that the servo may push, whatever is felt
# m/s of opening; slow against the relaxation that is looked for
APPROACH_SPEED = 0.025
PRESS_SPEED = 0.003
OPENING_SPEED = 0.015
CLEAR_TIME_MAX = 4.0  # s of opening and waiting, after which what is still felt is no touch
# s with the jaws still; s without touch before the second look
HOLD_TIME = 2.0
REST_TIME = 1.5
PRESS_TRAVEL_MAX = 0.010  # m to close after the first touch: what gives way that far is held there
CLEARANCE = 0.003  # m to open beyond the first touch
PHASE_TIME_MAX = 8.0  # s in one phase before giving up
BLIND_TIME_MAX = 0.5  # s without a usable image before giving up


def step(observation: Observation) -> Command:
    """One control cycle: dispatch on the phase that the last command was in."""
    memory = {
        "phase_time": 0.0,
        "blind_time": 0.0,
        "presses": 0.0,
        "touch_opening": 0.0,
        **observation.command.memory,
    }
    memory["phase_time"] += observation.period
    command = replace(observation.command, force_limit=SERVO_FORCE_LIMIT, memory=memory)
    felt = [touch.force_normal for touch in observation.touch]
    if not all(isfinite(force) for force in felt):  # unknown is not zero: stand still, then give up
        memory["blind_time"] += observation.period
        command = replace(command, memory=memory)
        return _go(command, "abort") if memory["blind_time"] > BLIND_TIME_MAX else command
    if memory["phase_time"] > PHASE_TIME_MAX:
        return _go(command, "abort")
    memory["blind_time"] = 0.0
    return _PHASES[command.phase](observation, replace(command, memory=memory), felt)


def _go(command: Command, phase: str, **values: float) -> Command:
    """Enter `phase` with its clock at zero, and remember `values`."""
    return replace(command, phase=phase, memory={**command.memory, "phase_time": 0.0, **values})


def _approach(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Close until either finger feels something; slowly where the first press found the object."""
    if max(felt) > TOUCH_FORCE:
        if command.memory["presses"]:
            return _go(command, "close")
        return _go(command, "close", touch_opening=observation.gripper.opening)
    if observation.gripper.opening <= 0.001:
        return _go(command, "abort")  # closed on nothing
    speed = PRESS_SPEED if command.memory["presses"] else APPROACH_SPEED
    return replace(command, opening=max(0.0, command.opening - speed * observation.period))


def _close(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Press at a steady speed up to the force, or as far as it may go."""
    second = command.memory["presses"] > 0
    enough = sum(felt) / len(felt) >= (SECOND_FORCE if second else PROBE_FORCE)
    if (
        enough
        or command.opening < command.memory["touch_opening"] - PRESS_TRAVEL_MAX
        or command.opening <= 0.001
    ):
        return _go(command, "release" if second else "hold", presses=command.memory["presses"] + 1)
    return replace(command, opening=command.opening - PRESS_SPEED * observation.period)


def _hold(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Keep the jaws still: what the force and the object do now is the object's own doing."""
    return _go(command, "release") if command.memory["phase_time"] >= HOLD_TIME else command


def _release(observation: Observation, command: Command, felt: list[float]) -> Command:
    """Open until nothing touches; then rest and look again, or end."""
    goal = command.memory["touch_opening"] + CLEARANCE
    opening = min(goal, command.opening + OPENING_SPEED * observation.period)
    if opening < goal or max(felt) > TOUCH_FORCE:
        clearing = command.memory.get("clearing", 0.0) + observation.period
        if clearing > CLEAR_TIME_MAX and opening >= goal:
            why = f"{max(felt):.2f} N are felt with the jaws open: is a finger calibrated?"
            return replace(_go(command, "abort"), reason=why)
        memory = {**command.memory, "phase_time": 0.0, "clearing": clearing}
        return replace(command, opening=opening, memory=memory)
    if command.memory["presses"] > 1:
        return _go(command, "done")
    if command.memory["phase_time"] >= REST_TIME:
        return _go(command, "approach", clearing=0.0)
    return command


def _end(observation: Observation, command: Command, felt: list[float]) -> Command:
    return command


_PHASES = {
    "approach": _approach,
    "close": _close,
    "hold": _hold,
    "release": _release,
    "done": _end,
    "abort": _end,
}
