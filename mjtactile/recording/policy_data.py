"""Observations and actions of a recording, as training data of a policy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.policy import (
    action_from_commands,
    command_from_action,
    policy_observation,
    policy_observation_names,
)
from mjtactile.core.signature_checks import validated
from mjtactile.core.task import load_task
from mjtactile.core.types import (
    Array,
    Command,
    GripperState,
    Observation,
    TaskGoal,
    Touch,
    Traction,
)
from mjtactile.recording.reader import Recording, load_recording

ACTION_NAMES = ("opening_speed", "force_limit", "lift_speed")
"""Names of the entries of an action, each from -1 to 1 (`mjtactile.command_from_action`)."""
REWARDS = {"held": 1.0, "crushed": -1.0, "dropped": -1.0}
"""Rewards at the end of an episode, by the outcome that `mjtactile evaluate` counts."""
_NODE = np.zeros(1)
_NOT_MOVING = np.zeros(len(ACTION_NAMES))


@dataclass(frozen=True, eq=False)
class PolicyData:
    """Training data of a policy, one row per cycle.

    Attributes:
        observations: Vectors (n, k) float32, named by `names`.
        actions: Actions (n, 3) that lead from one command to the next; NaN before a force limit
            was commanded.
        names: Names of the observations, with units.
    """

    observations: Array
    actions: Array
    names: tuple[str, ...]


@validated()
def policy_data(recording: Recording | str | Path) -> PolicyData:
    """Compute observations and actions of a recorded grasp.

    The observations are those that a policy would have in the same cycles. Their phases follow
    from touch and heights, not from the controller that was recorded.

    Args:
        recording: A recording, its folder, or the folder of its run.

    Returns:
        The data, in the order of the cycles.

    Raises:
        InputError: There is no recording, or it has no cycles.
    """
    read = recording if isinstance(recording, Recording) else load_recording(recording)
    if not len(read):
        raise InputError("has no cycles", source=read.folder)
    times = read.columns["time"]
    period = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    goal = _goal(read)
    own = last = _start(read)
    observations = []
    actions = []
    for cycle in range(len(read)):
        sent = read.command(cycle)
        shown = replace(last, phase=own.phase, memory=own.memory)
        observation = Observation(
            float(times[cycle]),
            period,
            _touches(read, cycle),
            _gripper(read, cycle),
            (),
            shown,
            goal,
        )
        action = _action(last, sent, period)
        own = command_from_action(observation, action)
        observations.append(policy_observation(observation))
        actions.append(action)
        last = _completed(last, sent)
    names = tuple(policy_observation_names(read.width))
    return PolicyData(np.array(observations), np.array(actions), names)


def _goal(recording: Recording) -> TaskGoal:
    """Return the goal of the recorded task; without one, the default."""
    scenario = recording.header.get("scenario")
    task = scenario.get("task") if isinstance(scenario, dict) else None
    try:
        return load_task(task).goal.task_goal() if task else TaskGoal()
    except InputError:  # a user's file that is missing
        return TaskGoal()


def _start(recording: Recording) -> Command:
    """Return the command before the first cycle: jaws and lift hold their positions."""
    notes = recording.notes
    opening = notes.get("start_opening")
    height = notes.get("start_lift_height")
    first = recording.command(0)
    return Command(
        first.opening if opening is None else float(opening),
        None,
        0.0 if height is None else float(height),
    )


def _completed(last: Command, sent: Command) -> Command:
    """Return the command without unknown values: a force limit of None is unchanged."""
    limit = last.force_limit if sent.force_limit is None else sent.force_limit
    return replace(sent, force_limit=limit)


def _action(last: Command, sent: Command, period: float) -> Array:
    if sent.force_limit is None and last.force_limit is None:
        return _NOT_MOVING * np.nan
    return action_from_commands(last, sent, period)


def _gripper(recording: Recording, cycle: int) -> GripperState:
    names = ("opening", "speed", "effort", "lift_height")
    return GripperState(*(float(recording.columns[name][cycle]) for name in names))


def _touches(recording: Recording, cycle: int) -> tuple[Touch, ...]:
    """Return the touches of a cycle, with the entries that an observation uses."""

    def values(key: str) -> Any:
        return recording.columns[key][cycle]

    return tuple(
        Touch(
            float(values("image_time")[k]),
            float("nan"),
            float(values("force_normal")[k]),
            float("nan"),
            bool(values("touching")[k]),
            traction=_traction(np.array(values("wrench")[k], float)),
        )
        for k in range(recording.width)
    )


def _traction(wrench: Array) -> Traction | None:
    if not np.isfinite(wrench).all():
        return None
    unknown = np.full((6, 6), np.nan)
    return Traction(_NODE, _NODE, np.zeros((1, 1, 3)), wrench, unknown, float("nan"), "recorded")
