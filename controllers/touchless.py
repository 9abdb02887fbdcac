"""A gripper without touch, to compare with: close until the servo's current says so, lift, hold,
put down, let go.

It looks at no sensor. A current is noisy, so that it is averaged over `AVERAGE_TIME`, and the jaws
close slowly enough for what comes in that time, at 160 N/m of grip, to be some 0.1 N; and it moves
the jaws, too, so that what that takes is measured before they meet anything. `EFFORT` is the force
at a jaw as the servo believes it, and what `gentle` grips with, so that the two differ in what they
feel and not in how firmly they mean to hold. In simulation that belief is right up to noise; a real
servo's gears keep a part of its torque to themselves, which is not in these numbers.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.types import Command, Observation

EFFORT = 0.6  # N on each finger
# s; in the second nothing is met
AVERAGE_TIME = 0.1
FREE_TIME = 0.5
# m/s
CLOSING_SPEED = 0.010
OPENING_SPEED = 0.040
LIFT_SPEED = 0.040
SETTLE_TIME = 0.4  # s
# s more than lowering takes: then what is held stands already, tilted, and keeps the hand up
LOWER_TIME_SPARE = 1.0
# m beyond the grip, s
RELEASE_OPENING = 0.012
RELEASE_TIME = 2.0
STOP_TIME = 0.3  # s that the rig lets the jaws close no further: they are at their own stop


def step(observation: Observation) -> Command:
    """One control cycle."""
    last = observation.command
    gripper = observation.gripper
    told = observation.told
    period = observation.period
    time = last.memory.get("phase_time", 0.0) + period
    effort = last.memory.get("effort", 0.0)
    if isfinite(gripper.effort):
        effort += min(1.0, period / AVERAGE_TIME) * (gripper.effort - effort)
    command = replace(
        last, force_limit=4.0, memory={**last.memory, "phase_time": time, "effort": effort}
    )
    if last.phase == "approach":
        return _approach(observation, command, time, effort)
    if last.phase == "regulate":
        return _go(command, "lift") if time >= SETTLE_TIME else command
    if last.phase == "lift":
        command = replace(
            command, lift_height=min(told.lift_height, last.lift_height + LIFT_SPEED * period)
        )
        is_up = gripper.lift_height > told.lift_height - 0.001
        return _go(command, "hold") if is_up else command
    if last.phase == "hold":
        return _go(command, "lower") if time >= told.hold_time else command
    if last.phase == "lower":
        goal = told.place_height
        command = replace(command, lift_height=max(goal, last.lift_height - LIFT_SPEED * period))
        time_max = (told.lift_height - goal) / LIFT_SPEED + LOWER_TIME_SPARE
        stands = gripper.lift_height < goal + 0.001 or time > time_max
        return _go(command, "release", grip=command.opening) if stands else command
    if last.phase == "release":
        goal = last.memory["grip"] + RELEASE_OPENING
        if gripper.opening > goal - 0.001 or time > RELEASE_TIME:
            return _go(command, "done")
        return replace(command, opening=min(goal, last.opening + OPENING_SPEED * period))
    return command


def _approach(observation: Observation, command: Command, time: float, effort: float) -> Command:
    """Close until the servos push with more than moving takes."""
    opening = observation.gripper.opening
    if time < FREE_TIME:
        command = replace(command, memory={**command.memory, "free": effort})
    elif effort - command.memory.get("free", 0.0) >= EFFORT:
        return _go(command, "regulate", opening=opening)
    # what was sent is what the rig allows
    gets_on = command.opening < command.memory.get("narrowest", 1.0) - 1e-4
    narrowest = command.opening if gets_on else command.memory["narrowest"]
    stuck = 0.0 if gets_on else command.memory["stuck"] + observation.period
    command = replace(command, memory={**command.memory, "narrowest": narrowest, "stuck": stuck})
    if stuck > STOP_TIME:
        return replace(_go(command, "abort"), reason="closed on nothing")
    return replace(command, opening=command.opening - CLOSING_SPEED * observation.period)


def _go(command: Command, phase: str, *, opening: float | None = None, **memory: float) -> Command:
    """Enter `phase` with its clock at zero."""
    opening = command.opening if opening is None else opening
    return replace(
        command,
        phase=phase,
        opening=opening,
        memory={**command.memory, "phase_time": 0.0, **memory},
    )
