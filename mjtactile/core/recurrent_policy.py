"""Memory of a learned policy: a gated recurrent unit (GRU) ahead of the layers of its file.

Its state is part of `Command.memory`, so that the controller remains a pure function. The vector
contains in addition the slip and the announced loads, which the required grip depends on, and how
the object will be released. Unit and layers receive the vector and its change since the previous
cycle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.policy import policy_observation, policy_observation_names
from mjtactile.core.signature_checks import validated, within
from mjtactile.core.types import Array, Observation, Touch

STATE = "policy_state"
"""Entry of `Command.memory`: the state (units + n,) of a recurrent policy."""
SLIP_MAX = 0.02
"""Maximum slip distance in the observation, m. Larger distances are clipped."""
_FINGER = ("incipient", "slipping", "slip_distance_m")
_GOAL = ("push_N", "acceleration_m_s2", "place_height_m", "handover")
_GATES = 3  # reset, update, candidate


@validated(fingers=within(0, 1000))
def recurrent_observation_names(fingers: int = 2) -> list[str]:
    """Name the entries of a recurrent policy's vector.

    Args:
        fingers: Number of fingers of the rig.

    Returns:
        (11 fingers + 18) names with their units, in the order of `recurrent_observation`.
    """
    slip = [f"finger{k}.{name}" for k in range(1, fingers + 1) for name in _FINGER]
    return [*policy_observation_names(fingers), *slip, *_GOAL]


@validated()
def recurrent_observation(observation: Observation) -> Array:
    """Compute the observation vector of a recurrent policy.

    Args:
        observation: Observation of a controller.

    Returns:
        Vector (11 fingers + 18,) float32: that of `policy_observation`, then each finger's slip,
        then push, N, acceleration, m/s^2, place height, m, and handover (0 or 1) of the goal.
    """
    slip = [value for touch in observation.touch for value in _slip_values(touch)]
    goal = observation.goal
    known = [goal.push, goal.acceleration, goal.place_height, float(goal.handover)]
    return np.concatenate([policy_observation(observation), np.array([*slip, *known], np.float32)])


def _slip_values(touch: Touch) -> tuple[float, float, float]:
    if touch.slip is None:
        return 0.0, 0.0, 0.0
    state = touch.slip.state
    distance = min(touch.slip.distance, SLIP_MAX) if math.isfinite(touch.slip.distance) else 0.0
    return float(state == "incipient"), float(state == "slipping"), distance


@dataclass(frozen=True, eq=False)
class RecurrentUnit:
    """Gated recurrent unit of Cho et al. (2014), in the form of PyTorch's `nn.GRU`.

    Rows are those of the reset gate, the update gate and the candidate.

    Attributes:
        gru_input_weights: (3 units, 2 n) Weights of vector and change.
        gru_state_weights: (3 units, units) Weights of the previous state.
        gru_input_biases: (3 units,) Biases next to the input weights.
        gru_state_biases: (3 units,) Biases next to the state weights.
    """

    gru_input_weights: Array
    gru_state_weights: Array
    gru_input_biases: Array
    gru_state_biases: Array

    @property
    def units(self) -> int:
        """Length of the state."""
        return self.gru_state_weights.shape[1]

    @property
    def inputs(self) -> int:
        """Length n of the observation vector."""
        return self.gru_input_weights.shape[1] // 2

    @property
    def features(self) -> int:
        """Number of inputs of the first layer: state, vector, change."""
        return self.units + 2 * self.inputs

    def after(self, vector: Array, kept: Sequence[float] | None) -> tuple[Array, list[float]]:
        """Update the state with one observation.

        Args:
            vector: Vector (n,) of `recurrent_observation`.
            kept: State after the previous observation; None before the first one.

        Returns:
            Input of the first layer: state, vector, change; and the state to be kept.
        """
        stored = np.zeros(self.units + self.inputs) if kept is None else np.asarray(kept)
        state, previous = np.split(stored, [self.units])
        change = np.zeros(self.inputs) if kept is None else vector - previous
        given = np.concatenate([vector, change])
        new = self.gru_input_weights @ given + self.gru_input_biases
        old = self.gru_state_weights @ state + self.gru_state_biases
        reset, update, candidate = np.split(new, _GATES)
        old_reset, old_update, old_candidate = np.split(old, _GATES)
        update = _logistic(update + old_update)
        candidate = np.tanh(candidate + _logistic(reset + old_reset) * old_candidate)
        state = (1 - update) * candidate + update * state
        return np.concatenate([state, given]), [*state.tolist(), *vector.tolist()]

    def scaled(self, center: Array, scale: Array) -> RecurrentUnit:
        """Return the unit for unscaled inputs, where this one has (input - center) / scale."""
        weights = self.gru_input_weights / scale
        biases = self.gru_input_biases - weights @ center
        return RecurrentUnit(weights, self.gru_state_weights, biases, self.gru_state_biases)


UNIT_ARRAYS = tuple(field.name for field in fields(RecurrentUnit))
"""Names of the unit's arrays in a file."""


def read_unit(values: dict[str, Any], sizes: Sequence[int], source: Any) -> RecurrentUnit | None:
    """Take the arrays of a recurrent unit out of those of a file, and check them.

    Args:
        values: Arrays by name; those of the unit are removed.
        sizes: Valid lengths of the observation vector.
        source: File, for messages.

    Returns:
        The unit; None in a file without one.

    Raises:
        InputError: An array is missing, or has the wrong shape or a value that is not finite.
    """
    found = {name: values.pop(name) for name in UNIT_ARRAYS if name in values}
    if not found:
        return None
    missing = [name for name in UNIT_ARRAYS if name not in found]
    if missing:
        raise InputError("is missing", source=source, field=missing[0])
    arrays = {name: np.asarray(value, float) for name, value in found.items()}
    shape = arrays["gru_input_weights"].shape
    units = shape[0] // _GATES if len(shape) == 2 else 0
    rows = _GATES * units
    width = shape[-1:]
    if width not in [(2 * size,) for size in sizes]:
        text = f"has {width[0] if width else 0} columns"
        choices = [str(2 * size) for size in sizes[:3]]
        raise InputError(text, source=source, field=UNIT_ARRAYS[0], choices=choices)
    shapes = [(rows, *width), (rows, units), (rows,), (rows,)]
    for (name, array), valid in zip(arrays.items(), shapes, strict=True):
        if array.shape != valid or not units:
            text = f"the shape {array.shape} does not match"
            raise InputError(text, source=source, field=name, choices=[str(valid)])
        if not np.isfinite(array).all():
            raise InputError("has values that are not finite", source=source, field=name)
    return RecurrentUnit(**arrays)


def _logistic(x: Array) -> Array:
    return 0.5 * (1.0 + np.tanh(0.5 * x))  # does not overflow
