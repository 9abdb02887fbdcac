"""Probe: load the object with a small force, hold the jaws, release, wait, and touch again to
measure the remaining indentation.

It is pure like `gentle.py`: its memory is in `Command.memory`. `mjtactile probe` estimates the
material from the measurements; this file only moves the jaws.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.grasp_estimation import phases
from mjtactile.types import Command, Observation

PROBE_FORCE = 0.9  # force per finger, N: a strawberry bruises at 1.2
# force of the second touch, N: enough to measure the surface, too little to indent it further
SECOND_FORCE = 0.35
TOUCH_FORCE = 0.08  # touch threshold, N: several times the noise of the estimate
SERVO_FORCE_LIMIT = 4.0  # maximum force of the servo, N, at any measured force
# opening speeds, m/s; slow relative to the measured relaxation
APPROACH_SPEED = 0.025
PRESS_SPEED = 0.003
OPENING_SPEED = 0.015
CLEAR_TIME_MAX = 4.0  # time of opening and waiting, s, after which a force is not a touch
# times at rest and, before the second touch, without contact, s
HOLD_TIME = 2.0
REST_TIME = 1.5
PRESS_TRAVEL_MAX = 0.010  # maximum closing after the first touch, m; softer objects are held there
CLEARANCE = 0.003  # opening beyond the first touch, m
PHASE_TIME_MAX = 8.0  # maximum time in one phase before an abort, s
BLIND_TIME_MAX = 0.5  # maximum time without a usable image, s


START: dict[str, float] = dict.fromkeys(
    ("phase_time", "blind_time", "presses", "touch_opening"), 0.0
)


def step(observation: Observation) -> Command:
    """Run one control cycle: the function of the last command's phase."""
    command = phases.start_cycle(observation, START, SERVO_FORCE_LIMIT)
    forces = [touch.force_normal for touch in observation.touch]
    if not all(
        isfinite(force) for force in forces
    ):  # an unknown force is not zero: stop, then abort
        blind_time = command.memory["blind_time"] + observation.period
        command = phases.remember(command, blind_time=blind_time)
        return phases.enter_phase(command, "abort") if blind_time > BLIND_TIME_MAX else command
    if command.memory["phase_time"] > PHASE_TIME_MAX:
        return phases.enter_phase(command, "abort")
    if command.phase not in _PHASES:  # "done" or "abort"
        return command
    return _PHASES[command.phase](observation, phases.remember(command, blind_time=0.0), forces)


def _approach(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Close until either finger measures a force; slowly near the position of the first touch."""
    if max(forces) > TOUCH_FORCE:
        if command.memory["presses"]:
            return phases.enter_phase(command, "close")
        return phases.enter_phase(command, "close", touch_opening=observation.gripper.opening)
    if observation.gripper.opening <= 0.001:
        return phases.enter_phase(command, "abort")  # closed without an object
    speed = PRESS_SPEED if command.memory["presses"] else APPROACH_SPEED
    return replace(command, opening=max(0.0, command.opening - speed * observation.period))


def _close(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Close at a constant speed up to the force, or to the travel limit."""
    second = command.memory["presses"] > 0
    enough = sum(forces) / len(forces) >= (SECOND_FORCE if second else PROBE_FORCE)
    if (
        enough
        or command.opening < command.memory["touch_opening"] - PRESS_TRAVEL_MAX
        or command.opening <= 0.001
    ):
        return phases.enter_phase(
            command, "release" if second else "hold", presses=command.memory["presses"] + 1
        )
    return replace(command, opening=command.opening - PRESS_SPEED * observation.period)


def _hold(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Keep the jaws at rest, so that changes of force and shape are due to the object alone."""
    return (
        phases.enter_phase(command, "release")
        if command.memory["phase_time"] >= HOLD_TIME
        else command
    )


def _release(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Open until there is no contact; then rest and approach again, or end."""
    goal = command.memory["touch_opening"] + CLEARANCE
    opening = min(goal, command.opening + OPENING_SPEED * observation.period)
    if opening < goal or max(forces) > TOUCH_FORCE:
        clearing = command.memory.get("clearing", 0.0) + observation.period
        if clearing > CLEAR_TIME_MAX and opening >= goal:
            why = f"a finger measures {max(forces):.2f} N with open jaws; check its calibration"
            return replace(phases.enter_phase(command, "abort"), reason=why)
        command = phases.remember(command, phase_time=0.0, clearing=clearing)
        return replace(command, opening=opening)
    if command.memory["presses"] > 1:
        return phases.enter_phase(command, "done")
    if command.memory["phase_time"] >= REST_TIME:
        return phases.enter_phase(command, "approach", clearing=0.0)
    return command


_PHASES = {"approach": _approach, "close": _close, "hold": _hold, "release": _release}
