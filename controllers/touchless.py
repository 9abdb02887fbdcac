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

from mjtactile.grasp_estimation import phases
from mjtactile.types import Command, Observation

EFFORT = 0.6  # force per finger, N
SERVO_FORCE_LIMIT = 4.0  # maximum force of the servo, N
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
START = {"phase_time": 0.0, "effort": 0.0, "free": 0.0, "stuck_time": 0.0}


def step(observation: Observation) -> Command:
    """Run one control cycle."""
    gripper = observation.gripper
    goal = observation.goal
    period = observation.period
    command = phases.start_cycle(observation, START, SERVO_FORCE_LIMIT)
    if isfinite(gripper.effort):
        effort = command.memory["effort"]
        effort += min(1.0, period / AVERAGE_TIME) * (gripper.effort - effort)
        command = phases.remember(command, effort=effort)
    time = command.memory["phase_time"]
    if command.phase == "approach":
        return _approach(observation, command)
    if command.phase == "regulate":
        return phases.enter_phase(command, "lift") if time >= SETTLE_TIME else command
    if command.phase == "lift":
        height = min(goal.lift_height, command.lift_height + LIFT_SPEED * period)
        command = replace(command, lift_height=height)
        is_up = gripper.lift_height > goal.lift_height - 0.001
        return phases.enter_phase(command, "hold") if is_up else command
    if command.phase == "hold":
        return phases.enter_phase(command, "lower") if time >= goal.hold_time else command
    if command.phase == "lower":
        height = goal.place_height
        time_max = (goal.lift_height - height) / LIFT_SPEED + LOWER_TIME_SPARE
        command = replace(
            command, lift_height=max(height, command.lift_height - LIFT_SPEED * period)
        )
        is_down = gripper.lift_height < height + 0.001 or time > time_max
        return phases.start_release(command) if is_down else command
    if command.phase == "release":
        opening = command.memory["grip_opening"] + RELEASE_OPENING
        if gripper.opening > opening - 0.001 or time > RELEASE_TIME:
            return phases.enter_phase(command, "done")
        return replace(command, opening=min(opening, command.opening + OPENING_SPEED * period))
    return command


def _approach(observation: Observation, command: Command) -> Command:
    """Close until the servo effort exceeds that of free motion."""
    effort = command.memory["effort"]
    if command.memory["phase_time"] < FREE_TIME:
        command = phases.remember(command, free=effort)
    elif effort - command.memory["free"] >= EFFORT:
        command = replace(command, opening=observation.gripper.opening)
        return phases.enter_phase(command, "regulate")
    command = phases.update_stuck_clock(observation, command)
    if command.phase == "abort":
        return command
    return replace(command, opening=command.opening - CLOSING_SPEED * observation.period)
