"""Phases of a grasp and their clocks, shared by the controllers.

A controller is a pure function: its phase is `Command.phase`, and its clocks are entries of
`Command.memory`, in s. `phase_time` is the time in the phase, and `settled_time` the time within
the force tolerance. `blind_time` and `lost_time` are times without a force estimate and without
contact. `stuck_time` is the time without further closing. Each function returns a new command.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from typing import Any

from mjtactile.core.types import Command, Observation
from mjtactile.grasp_estimation.touch_statics import shear, support_force

_MIN_STEP = 1e-4  # minimum decrease of the opening, m, that counts as closing
_NEAR = 0.001  # tolerance of heights and openings, m
_LOWER_TIME_SPARE = 1.0  # s; by then the object stands, tilted, and supports the gripper


def remember(command: Command, **values: Any) -> Command:
    """Store values in the controller's memory."""
    return replace(command, memory={**command.memory, **values})


def enter_phase(command: Command, phase: str, **values: Any) -> Command:
    """Enter a phase with its clocks at zero, and store values in the memory."""
    clocks = {name: 0.0 for name in ("phase_time", "settled_time") if name in command.memory}
    return replace(remember(command, **clocks, **values), phase=phase)


def abort(command: Command, reason: str) -> Command:
    """End the run for this reason."""
    return replace(enter_phase(command, "abort"), reason=reason)


def start_cycle(observation: Observation, start: Mapping[str, Any], force_limit: float) -> Command:
    """Return the last command, with this force limit, N, and the clock of its phase advanced.

    `start` are the initial values of the memory.
    """
    memory = {**start, **observation.command.memory}
    memory["phase_time"] += observation.period
    return replace(observation.command, force_limit=force_limit, memory=memory)


def update_contact_clocks(
    observation: Observation, command: Command, contact_force: float, blind_time_max: float
) -> Command:
    """Update `blind_time` and `lost_time`; abort after `blind_time_max` s without a force estimate.

    An unknown force is not zero: until then the command stays as it is. There is contact if a force
    exceeds `contact_force`, N.
    """
    unknown = [touch for touch in observation.touch if not isfinite(touch.force_normal)]
    if not unknown:
        in_contact = max(touch.force_normal for touch in observation.touch) > contact_force
        lost_time = 0.0 if in_contact else command.memory["lost_time"] + observation.period
        return remember(command, blind_time=0.0, lost_time=lost_time)
    command = remember(command, blind_time=command.memory["blind_time"] + observation.period)
    if command.memory["blind_time"] > blind_time_max:
        return abort(command, f"the contact force is unknown: {unknown[0].status}")
    return command


def update_stuck_clock(observation: Observation, command: Command, stop_time: float) -> Command:
    """Update `stuck_time`; abort after `stop_time` s in which the rig has not closed the jaws.

    The last command is already limited by the rig.
    """
    narrowest = command.memory.get("narrowest", 1.0)
    if command.opening < narrowest - _MIN_STEP:
        return remember(command, stuck_time=0.0, narrowest=command.opening)
    stuck_time = command.memory["stuck_time"] + observation.period
    command = remember(command, stuck_time=stuck_time)
    return abort(command, "the jaws closed without contact") if stuck_time > stop_time else command


def settle(
    observation: Observation,
    command: Command,
    is_settled: bool,
    *,
    settle_time: float,
    timeout: float,
) -> Command:
    """Enter "lift" after the force was settled for `settle_time` s; abort after `timeout` s."""
    settled_time = command.memory["settled_time"] + observation.period if is_settled else 0.0
    if settled_time >= settle_time:
        return enter_phase(command, "lift")
    if command.memory["phase_time"] > timeout:
        return abort(command, "the force did not settle")
    return remember(command, settled_time=settled_time)


def hold(observation: Observation, command: Command) -> Command:
    """Store the shear of the held object; enter "lower" after the hold time of the goal."""
    command = remember(command, held=shear(observation.touch).tolist())
    is_over = command.memory["phase_time"] >= observation.goal.hold_time
    return enter_phase(command, "lower") if is_over else command


def lower(
    observation: Observation, command: Command, *, speed: float, table_force: float
) -> Command:
    """Lower the gripper at `speed` m/s until the object stands; then enter "release".

    An object that slid down in the grip reaches the table before the gripper is down. Further
    lowering would press it onto its edge. It then pushes each finger up by more than `table_force`,
    N.
    """
    goal = observation.goal.place_height
    height = max(goal, command.lift_height - speed * observation.period)
    command = replace(command, lift_height=height)
    held = command.memory.get("held", shear(observation.touch))
    time_max = (observation.goal.lift_height - goal) / speed + _LOWER_TIME_SPARE
    is_late = command.memory["phase_time"] > time_max
    is_down = height == goal and (observation.gripper.lift_height < goal + _NEAR or is_late)
    if is_down or support_force(observation.touch, held) > table_force:
        return start_release(command)
    return command


def start_release(command: Command, **values: Any) -> Command:
    """Enter "release" at the current opening, and store values in the memory."""
    return enter_phase(command, "release", grip_opening=command.opening, **values)


def release(
    observation: Observation,
    command: Command,
    *,
    speed: float,
    clearance: float,
    contact_force: float,
    timeout: float,
) -> Command:
    """Open at `speed` m/s until the jaws are `clearance` m beyond the grip, without contact.

    The run then ends with "done", or with "abort" if the memory has an entry `lost`. It also aborts
    if a finger measures `contact_force`, N, for `timeout` s.
    """
    goal = command.memory["grip_opening"] + clearance
    is_free = max(touch.force_normal for touch in observation.touch) < contact_force
    if observation.gripper.opening > goal - _NEAR and is_free:
        return enter_phase(command, "abort" if "lost" in command.memory else "done")
    if command.memory["phase_time"] > timeout:
        return abort(command, "the object sticks to a finger")
    return replace(command, opening=min(goal, command.opening + speed * observation.period))
