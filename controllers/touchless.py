"""A gripper without touch, for comparison: close up to a servo current, lift, hold, place, release.

It reads no tactile sensor. The current is noisy and therefore averaged over `AVERAGE_TIME`. The
jaws close slowly: the force grows by some 0.1 N in that time at a grip stiffness of 160 N/m. The
current also moves the jaws; that part is measured before they touch the object. `EFFORT` is the
force at a jaw estimated from the servo current. It equals the grip force of `gentle`, so that the
two controllers differ in sensing and not in the intended grip. In simulation that estimate is
correct up to noise. A real servo's gears absorb a part of its torque, which these values do not
include.
"""

from dataclasses import replace
from math import isfinite

from mjtactile.types import Command, Observation

EFFORT = 0.6  # force per finger, N
# averaging time and initial time without contact, s
AVERAGE_TIME = 0.1
FREE_TIME = 0.5
# speeds, m/s
CLOSING_SPEED = 0.010
OPENING_SPEED = 0.040
LIFT_SPEED = 0.040
SETTLE_TIME = 0.4  # settling time, s
# extra time for lowering, s: then the object already stands, tilted, and supports the gripper
LOWER_TIME_SPARE = 1.0
# opening beyond the grip, m, and time limit of the release, s
RELEASE_OPENING = 0.012
RELEASE_TIME = 2.0
STOP_TIME = 0.3  # time, s, without further closing by the rig: the jaws are at their stop


def step(observation: Observation) -> Command:
    """One control cycle."""
    last = observation.command
    gripper = observation.gripper
    goal = observation.goal
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
            command, lift_height=min(goal.lift_height, last.lift_height + LIFT_SPEED * period)
        )
        is_up = gripper.lift_height > goal.lift_height - 0.001
        return _go(command, "hold") if is_up else command
    if last.phase == "hold":
        return _go(command, "lower") if time >= goal.hold_time else command
    if last.phase == "lower":
        height = goal.place_height
        command = replace(command, lift_height=max(height, last.lift_height - LIFT_SPEED * period))
        time_max = (goal.lift_height - height) / LIFT_SPEED + LOWER_TIME_SPARE
        stands = gripper.lift_height < height + 0.001 or time > time_max
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
    # the last command is already limited by the rig
    gets_on = command.opening < command.memory.get("narrowest", 1.0) - 1e-4
    narrowest = command.opening if gets_on else command.memory["narrowest"]
    stuck = 0.0 if gets_on else command.memory["stuck"] + observation.period
    command = replace(command, memory={**command.memory, "narrowest": narrowest, "stuck": stuck})
    if stuck > STOP_TIME:
        return replace(_go(command, "abort"), reason="the jaws closed without contact")
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
