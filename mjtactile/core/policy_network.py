"""Checks of a policy's network: shapes, finite values, activation. Each defect is one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.policy import policy_observation_names
from mjtactile.core.recurrent_policy import RecurrentUnit, recurrent_observation_names
from mjtactile.core.types import Array

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}
"""Activations between the layers, by name."""
OUTPUTS = 3
"""Length of an action."""
DEFAULT_ACTIVATION = "tanh"
"""Activation of files that name none."""
_FINGERS_MAX = 8
SIZES = {len(policy_observation_names(n)): n for n in range(1, _FINGERS_MAX + 1)}
"""Number of fingers by the length of the observation vector."""
RECURRENT_SIZES = {len(recurrent_observation_names(n)): n for n in range(1, _FINGERS_MAX + 1)}
"""The same of a recurrent policy."""
Layers = Sequence[tuple[Array, Array]]
"""Weights and biases, first to last."""


def check_layers(layers: Layers, source: Any, unit: RecurrentUnit | None = None) -> None:
    """Check that each layer fits the one before, the observation, and the action."""
    if not layers:
        raise InputError("has no layers", source=source, field="layers")
    first = layers[0][0].shape
    inputs = first[1] if len(first) == 2 else 0
    sizes = SIZES if unit is None else {unit.features: RECURRENT_SIZES[unit.inputs]}
    if inputs not in sizes:
        is_turned = len(first) == 2 and first[0] in sizes
        text = f"weights {first} have {inputs} inputs{_transposed_hint(is_turned)}"
        choices = [f"{size} for {n} finger{'s' if n > 1 else ''}" for size, n in sizes.items()]
        raise InputError(text, source=source, field="layers[0]", choices=choices[:3])
    for k, (w, b) in enumerate(layers):
        outputs = OUTPUTS if k == len(layers) - 1 else b.size
        if w.shape != (outputs, inputs) or b.shape != (outputs,):
            hint = _transposed_hint(w.shape == (inputs, outputs))
            text = f"weights {w.shape} and biases {b.shape} do not match{hint}"
            choices = [f"weights ({outputs}, {inputs}) and biases ({outputs},)"]
            raise InputError(text, source=source, field=f"layers[{k}]", choices=choices)
        inputs = outputs


def _transposed_hint(is_turned: bool) -> str:
    return "; the weights are transposed" if is_turned else ""


def check_finite(layers: Layers, source: Any) -> None:
    """Check that all weights and biases are finite."""
    for k, layer in enumerate(layers):
        for name, values in zip(("weights", "biases"), layer, strict=True):
            count = int(np.size(values) - np.isfinite(values).sum())
            if count:
                text = f"{count} of {np.size(values)} {name} are not finite"
                raise InputError(text, source=source, field=f"layers[{k}]")


def checked_activation(name: str | None, layers: int, source: Any) -> str:
    """Return the name of the activation; a single layer needs none."""
    if name is None and layers == 1:
        return DEFAULT_ACTIVATION
    if name not in ACTIVATIONS:
        text = "is not given" if name is None else f"{name!r} is unknown"
        raise InputError(text, source=source, field="activation", choices=list(ACTIVATIONS))
    return name


def sized(count: int, sizes: Mapping[int, int]) -> str:
    """Describe a length of a vector, with the number of fingers in `sizes`."""
    fingers = sizes.get(count)
    of = f" (of {fingers} finger{'s' if fingers > 1 else ''})" if fingers else ""
    return f"{count} values{of}"
