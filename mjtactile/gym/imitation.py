"""Imitation of a controller by a recurrent policy: inputs of the network, actions of the teacher.

The policy acts, and the teacher adds its action in the same states: DAgger of Ross et al. (2011),
"A Reduction of Imitation Learning and Structured Prediction to No-Regret Online Learning".
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mjtactile.core.policy import action_from_commands, command_from_action
from mjtactile.core.recurrent_policy import recurrent_observation as recurrent_observation
from mjtactile.core.recurrent_policy import recurrent_observation_names
from mjtactile.core.types import Array, Command, Observation
from mjtactile.gym.wrappers import SCALE

_INTEGRAL = "goal"  # of the jaws, in the memory of `adaptive`
# These differ on a real servo: its current includes friction in its gears
_OMITTED = ("speed_m_s", "effort_N")
_SCALE = {"slip_distance_m": 2e-3, "push_N": 0.3, "acceleration_m_s2": 5.0, "place_height_m": 0.02}
_CHANGE = {  # of one image; other entries without their change
    "force_normal_N": 0.03,
    "fx_N": 0.02,
    "fy_N": 0.02,
    "tx_Nm": 2e-4,
    "ty_Nm": 2e-4,
    "tz_Nm": 1e-4,
    "opening_m": 5e-4,
    "goal_ahead_m": 5e-4,
    "lift_height_m": 1e-3,
    "slip_distance_m": 1e-4,
}
_KINDS = [name.rpartition(".")[2] for name in recurrent_observation_names()]
_VALUE_SCALE = np.concatenate([SCALE, [_SCALE.get(name, 1.0) for name in _KINDS[len(SCALE) :]]])
_VALUE_SCALE[np.isin(_KINDS, _OMITTED)] = np.inf
INPUT_SCALE = np.concatenate([_VALUE_SCALE, [_CHANGE.get(name, np.inf) for name in _KINDS]])
"""Vector and change that are scaled to 1, (2 n,) for two fingers; inf: not used."""


def teacher_action(observation: Observation, teacher: Command) -> Array:
    """Compute the action that imitates a teacher.

    Where the policy's phase does not permit a release, it holds an object that the teacher would
    release; in its phase "release", it opens the jaws, even if the teacher still lowers.

    Args:
        observation: Observation of the policy, with its last command.
        teacher: The teacher's command at the same observation.

    Returns:
        Action (3,) of `command_from_action`.
    """
    action = action_from_commands(observation.command, teacher, observation.period)
    phase = command_from_action(observation, action).phase
    if phase == "release":
        return np.array([1.0, action[1], 0.0])
    if teacher.phase in ("release", "done"):
        if phase == "lower" or (phase == "hold" and observation.goal.handover):
            return np.array([1.0, action[1], 0.0])
        if phase in ("lift", "hold"):
            return np.array([0.0, action[1], 0.0])
    return action


def ask_teacher(teacher, observation: Observation, before: Command | None) -> Command:
    """Return the teacher's command, which continues its own phase and memory, not the policy's.

    Its regulation starts from the opening that the policy commanded: the integral of an opening
    that was never sent would dominate its actions.

    Args:
        teacher: Loaded controller.
        observation: Observation of the policy.
        before: The teacher's previous command; None at the start.
    """
    own = observation.command
    if before is not None:
        memory = {name: kept for name, kept in before.memory.items() if name != _INTEGRAL}
        own = replace(own, phase=before.phase, memory=memory)
    return teacher.step(replace(observation, command=own))


def scaled_inputs(vectors: Array) -> Array:
    """Return scaled vectors and changes (t, 2 n) of an episode's vectors (t, n)."""
    change = np.diff(vectors, axis=0, prepend=vectors[:1])
    return (np.concatenate([vectors, change], axis=1) / INPUT_SCALE).astype(np.float32)
