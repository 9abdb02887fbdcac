"""Observation and action of a learned policy.

They are identical in a Gymnasium environment, in training, and in a controller on a rig.

A policy maps one vector (`policy_observation`) to an action (3,) in [-1, 1]. The action sets
opening speed, force limit and lift speed (`command_from_action`). The observation contains the
phase of the grasp, from approach to release. Touch and heights determine it. A policy without
memory can therefore lift, hold and set down.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import above, validated, within
from mjtactile.core.types import Array, Command, Observation, Touch

# limits of an action's range: m/s, N, m/s
OPENING_SPEED = 0.05
FORCE_LIMIT = 8.0
LIFT_SPEED = 0.05
PHASES = ("approach", "close", "regulate", "lift", "hold", "lower", "release")
# height thresholds, m: lift detected; deviation from the lift goal; distance above the table
RISEN = 0.002
NEAR = 0.001
DOWN = 0.001
CLEAR = 0.008  # opening beyond the grip at which the object is released, m
LEAD = 0.004  # maximum lead of the opening's goal over the jaws, m
TIME_MAX = 3.0  # maximum time in a phase in the observation, s
_NOTHING = [0.0] * 6
LOST_TIME = 0.5  # time without contact after which the gripper is lowered again, s
_FINGER = (
    ("known", 1.0),
    ("touching", 1.0),
    ("force_normal_N", 50.0),
    ("fx_N", 50.0),
    ("fy_N", 50.0),
    ("tx_Nm", 1.0),
    ("ty_Nm", 1.0),
    ("tz_Nm", 1.0),
)
_RIG = (
    ("opening_m", 1.0),
    ("speed_m_s", 1.0),
    ("effort_N", 100.0),
    ("lift_height_m", 1.0),
    ("goal_ahead_m", 1.0),
    ("force_limit_N", 100.0),
    ("phase_time_s", TIME_MAX),
    *((phase, 1.0) for phase in PHASES),
)


@validated(fingers=within(0, 1000))
def policy_observation_names(fingers: int = 2) -> list[str]:
    """Name the entries of a policy's vector.

    Args:
        fingers: Number of fingers of the rig.

    Returns:
        (8 fingers + 14) names with their units, in the order of `policy_observation`.
    """
    return [f"finger{k}.{name}" for k in range(1, fingers + 1) for name, _ in _FINGER] + [
        name for name, _ in _RIG
    ]


def policy_bounds(fingers: int = 2) -> Array:
    """Return the maximum absolute value of each entry of a vector. Larger values are clipped."""
    return _bounds(fingers).copy()


@cache
def _bounds(fingers: int) -> Array:
    return np.array(
        [maximum for _ in range(fingers) for _, maximum in _FINGER]
        + [maximum for _, maximum in _RIG]
    )


@validated()
def policy_observation(observation: Observation) -> Array:
    """Compute the observation vector of a policy.

    Args:
        observation: Observation of a controller.

    Returns:
        Vector (8 fingers + 14,) float32, named by `policy_observation_names`. An unknown force is 0
        with `known` 0. The force limit is 0 in the first cycle, before any was commanded.
    """
    command = observation.command
    gripper = observation.gripper
    phase = command.phase if command.phase in PHASES else PHASES[0]
    rig = [
        gripper.opening,
        gripper.speed,
        gripper.effort,
        gripper.lift_height,
        command.opening - gripper.opening,
        0.0 if command.force_limit is None else command.force_limit,
        min(command.memory.get("phase_time", 0.0), TIME_MAX),
        *(float(phase == name) for name in PHASES),
    ]
    values = np.array(
        [value for touch in observation.touch for value in _touch_values(touch)] + rig, float
    )
    values[~np.isfinite(values)] = 0.0
    maximum = _bounds(len(observation.touch))
    return np.minimum(np.maximum(values, -maximum), maximum).astype(np.float32)


@validated()
def command_from_action(observation: Observation, action: ArrayLike) -> Command:
    """Compute the command of a policy's action.

    Args:
        observation: Observation of the policy.
        action: Opening speed, force limit and lift speed (3,), each clipped to [-1, 1]. Non-finite
            values count as 0.

    Returns:
        The command, with the current phase of the grasp.

    Raises:
        InputError: The action has not three values.
    """
    values = np.asarray(action, float)
    if values.shape != (3,):
        text = f"shape {values.shape} does not match (3,)"
        raise InputError(text, source="command_from_action", field="action")
    rate, limit, lift = (_clip_to_one(value) for value in values.tolist())
    last = observation.command
    period = observation.period
    gripper = observation.gripper
    opening = last.opening + OPENING_SPEED * rate * period
    if math.isfinite(gripper.opening):
        opening = min(max(opening, gripper.opening - LEAD), gripper.opening + LEAD)
    height = min(
        max(last.lift_height + LIFT_SPEED * lift * period, 0.0), observation.goal.lift_height
    )
    phase, memory = _progress(observation)
    force = FORCE_LIMIT * (limit + 1) / 2
    opening = max(opening, 0.0)
    return Command(opening, force, height, phase, memory, last.reason, last.gauge_pressure)


def fraction_released(sent: Command) -> float:
    """Return the progress of a release: 0 at the grip's goal, ahead of the jaws, 1 when the object
    is released.

    `sent` is a command of `command_from_action`.
    """
    grip = sent.memory.get("grip_opening", sent.opening)
    return (sent.opening - grip + LEAD) / (CLEAR + LEAD)


@validated(period=above(0))
def action_from_commands(before: Command, after: Command, period: float) -> Array:
    """Compute the action between two commands, as training data from a teacher.

    Args:
        before: The command of the previous cycle.
        after: The command of this cycle.
        period: Time between them, s.

    Returns:
        Action (3,) in [-1, 1], as used by `command_from_action`.

    Raises:
        InputError: Neither command has a force limit.
    """
    limit = before.force_limit if after.force_limit is None else after.force_limit
    if limit is None:
        raise InputError("no force limit was commanded", source="Command", field="force_limit")
    return np.clip(
        [
            (after.opening - before.opening) / (OPENING_SPEED * period),
            2 * limit / FORCE_LIMIT - 1,
            (after.lift_height - before.lift_height) / (LIFT_SPEED * period),
        ],
        -1.0,
        1.0,
    )


def _clip_to_one(value: float) -> float:
    return 0.0 if math.isnan(value) else min(max(value, -1.0), 1.0)


def _touch_values(touch: Touch) -> list[float]:
    known = math.isfinite(touch.force_normal)
    wrench = _NOTHING
    if known and touch.traction is not None:
        wrench = touch.traction.wrench.tolist()
    is_touching = float(touch.touching)
    return [float(known), is_touching, touch.force_normal, *wrench[:2], *wrench[3:]]


def _progress(observation: Observation) -> tuple[str, Mapping[str, float]]:
    """Return the current phase of the grasp and its memory (durations, s), from contact and height
    only."""
    last = observation.command
    gripper = observation.gripper
    before = last.phase if last.phase in (*PHASES, "done", "abort") else PHASES[0]
    time = last.memory.get("phase_time", 0.0) + observation.period
    grip = last.memory.get("grip_opening", gripper.opening)
    if any(touch.touching for touch in observation.touch):
        lost = 0.0
    else:
        lost = last.memory.get("lost_time", 0.0) + observation.period
    if before in ("lift", "hold") and lost > LOST_TIME:
        phase = "lower"
    else:
        phase = _next(before, observation, time, grip)
    if phase != before:
        time = 0.0
    if phase == before and _may_release(phase, observation):
        grip = min(grip, gripper.opening)
    elif phase not in ("release", "done", "abort"):
        grip = gripper.opening
    gone = last.memory.get("gone", 0.0) or float(phase == "lower" and lost > LOST_TIME)
    phase = "abort" if phase == "done" and gone else phase
    return phase, {
        "phase_time": time,
        "lost_time": lost,
        "gone": gone,
        "grip_opening": grip if math.isfinite(grip) else 0.0,
    }


def _may_release(phase: str, observation: Observation) -> bool:
    """Return True in a phase in which the policy decides on the release, by opening."""
    return phase == "lower" or (phase == "hold" and observation.goal.handover)


def _next(phase: str, observation: Observation, time: float, grip: float) -> str:
    touching = [touch.touching for touch in observation.touch]
    gripper = observation.gripper
    height = gripper.lift_height
    if phase in ("approach", "close", "regulate"):
        if height > RISEN:
            return "lift"
        if all(touching):
            return "regulate"
        return "close" if any(touching) else "approach"
    if _may_release(phase, observation) and observation.command.opening > grip + NEAR:
        return "release"
    if phase == "hold" and observation.goal.handover:
        return phase if any(touching) else "release"
    ends = {
        "lift": height > observation.goal.lift_height - NEAR,
        "hold": time >= observation.goal.hold_time,
        "lower": height < DOWN,
        "release": not any(touching) and gripper.opening > grip + CLEAR,
    }
    after = {"lift": "hold", "hold": "lower", "lower": "release", "release": "done"}
    return after[phase] if ends.get(phase, False) else phase
