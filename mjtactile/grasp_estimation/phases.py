"""Phases of a grasp and their clocks, shared by the controllers.

A controller is a pure function: its phase is `Command.phase`, and its clocks are entries of
`Command.memory`, in s. `phase_time` is the time in the phase, and `settled_time` the time within
the force tolerance. `blind_time` and `lost_time` are times without a force estimate and without
contact. `stuck_time` is the time without further closing. Each function returns a new command.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf, isfinite
from typing import Any

from mjtactile.core.types import Command, Observation
from mjtactile.grasp_estimation.touch_statics import shear, support_force

Phase = Callable[[Observation, Command, list[float]], Command]
"""Part of a controller: observation, command and the fingers' normal forces, N, to a command."""

HOLDING = ("lift", "hold", "lower")
"""Phases in which the object can be lost."""

GRIP_TIMEOUT = 6.0
"""Maximum time of closing on an object, of settling the force and of releasing, s."""

_MAX_BLIND_TIME, _LOST_TIME = 0.5, 0.3  # times without a usable image and without contact, s
_STOP_TIME = 0.3  # time, s, without further closing by the rig: the jaws are at their stop
_SLOW = 0.3  # fraction of the closing speed while one finger has contact
_CLEARANCE = 0.012  # opening beyond the grip at the end of a run, m
_MIN_STEP = 1e-4  # minimum decrease of the opening, m, that counts as closing
_NEAR = 0.001  # tolerance of heights and openings, m
_CLOCKS: dict[str, float] = dict.fromkeys(
    ("phase_time", "settled_time", "blind_time", "lost_time", "stuck_time"), 0.0
)
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


def run_cycle(
    observation: Observation,
    functions: Mapping[str, Phase],
    *,
    start: Mapping[str, Any],
    force_limit: float,
    contact_force: float,
    update: Phase | None = None,
    lost_slip: float = inf,
) -> Command:
    """Run one control cycle of a grasp: the function of the phase that the last command was in.

    The command stays as it is while a force is unknown. If the object is lost, the gripper releases
    at its height, not down onto the fallen object, and the run ends with "abort".

    Args:
        observation: Present observation.
        functions: Function of each phase; phases without one end the run.
        start: Initial values of the memory, in addition to the clocks.
        force_limit: Maximum servo force on each finger, N.
        contact_force: Minimum normal force of a finger in contact, N.
        update: Called before the function of a phase of `HOLDING`.
        lost_slip: Slip distance of every finger, m, of a lost object.

    Returns:
        The next command.
    """
    command = start_cycle(observation, {**_CLOCKS, **start}, force_limit)
    command = _update_contact_clocks(observation, command, contact_force)
    forces = [touch.force_normal for touch in observation.touch]
    if not all(isfinite(force) for force in forces):
        return command
    if command.phase in HOLDING:
        slips = [0.0 if touch.slip is None else touch.slip.distance for touch in observation.touch]
        if command.memory["lost_time"] > _LOST_TIME or min(slips) > lost_slip:
            command = replace(command, reason="the object slipped out of the grasp")
            return start_release(command, lost=1.0)
        if update is not None:
            command = update(observation, command, forces)
    function = functions.get(command.phase)
    return command if function is None else function(observation, command, forces)


def _update_contact_clocks(
    observation: Observation, command: Command, contact_force: float
) -> Command:
    """Update `blind_time` and `lost_time`. Abort after a long time without a force estimate."""
    unknown = [touch for touch in observation.touch if not isfinite(touch.force_normal)]
    if not unknown:
        in_contact = max(touch.force_normal for touch in observation.touch) > contact_force
        lost_time = 0.0 if in_contact else command.memory["lost_time"] + observation.period
        return remember(command, blind_time=0.0, lost_time=lost_time)
    command = remember(command, blind_time=command.memory["blind_time"] + observation.period)
    if command.memory["blind_time"] > _MAX_BLIND_TIME:
        return abort(command, f"the contact force is unknown: {unknown[0].status}")
    return command


def update_stuck_clock(observation: Observation, command: Command) -> Command:
    """Update `stuck_time`; abort if the rig has not closed the jaws for 0.3 s.

    The last command is already limited by the rig.
    """
    narrowest = command.memory.get("narrowest", 1.0)
    if command.opening < narrowest - _MIN_STEP:
        return remember(command, stuck_time=0.0, narrowest=command.opening)
    stuck_time = command.memory["stuck_time"] + observation.period
    command = remember(command, stuck_time=stuck_time)
    if stuck_time > _STOP_TIME:
        return abort(command, "the jaws closed without contact")
    return command


def approach(
    observation: Observation,
    command: Command,
    forces: list[float],
    *,
    speed: float,
    contact_force: float,
    max_force: float,
) -> Command:
    """Close at `speed` m/s until a finger detects contact, then slowly ("close") until both press
    with `contact_force` N.

    "regulate" follows, also if one finger measures more than `max_force` N.
    """
    if min(forces) > contact_force or max(forces) > max_force:
        return enter_phase(command, "regulate")
    command = update_stuck_clock(observation, command)
    if command.phase == "abort":
        return command
    if command.phase == "close" and command.memory["phase_time"] > GRIP_TIMEOUT:
        return abort(command, "only one finger touches the object")
    if command.phase == "approach" and any(touch.touching for touch in observation.touch):
        return enter_phase(command, "close")
    fraction = 1.0 if command.phase == "approach" else _SLOW
    return replace(command, opening=command.opening - fraction * speed * observation.period)


def settle(
    observation: Observation, command: Command, is_settled: bool, settle_time: float
) -> Command:
    """Enter "lift" after the force was settled for `settle_time` s. Abort after `GRIP_TIMEOUT`."""
    settled_time = command.memory["settled_time"] + observation.period if is_settled else 0.0
    if settled_time >= settle_time:
        return enter_phase(command, "lift")
    if command.memory["phase_time"] > GRIP_TIMEOUT:
        return abort(command, "the force did not settle")
    return remember(command, settled_time=settled_time)


def hold(observation: Observation, command: Command) -> Command:
    """Store the shear of the held object. Enter "lower" after the hold time of the goal."""
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
    forces: list[float],
    *,
    speed: float,
    contact_force: float,
) -> Command:
    """Open at `speed` m/s until the jaws are 12 mm beyond the grip, without contact.

    The run then ends with "done", or with "abort" if the memory has an entry `lost`. It also aborts
    if a finger measures `contact_force`, N, for `GRIP_TIMEOUT`.
    """
    goal = command.memory["grip_opening"] + _CLEARANCE
    is_free = max(forces) < contact_force
    if observation.gripper.opening > goal - _NEAR and is_free:
        return enter_phase(command, "abort" if "lost" in command.memory else "done")
    if command.memory["phase_time"] > GRIP_TIMEOUT:
        return abort(command, "the object sticks to a finger")
    return replace(command, opening=min(goal, command.opening + speed * observation.period))
