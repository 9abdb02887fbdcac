"""Small regression network with two hidden layers: evaluation, and fit by Adam, in numpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array

_RATE = (1e-2, 1e-4)  # learning rate at the start and at the end
_MOMENTS = (0.9, 0.99)
_TINY = 1e-8
_BATCH = 256

Layer = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Network:
    """Layers of a network. Each is a matrix (outputs, inputs) and an offset (outputs,). All but the
    last are followed by max(x, 0)."""

    layers: tuple[Layer, ...]

    def __call__(self, x: Array) -> Array:
        """Return the outputs (m,) or (n, m) for inputs (k,) or (n, k)."""
        for weight, offset in self.layers[:-1]:
            x = np.maximum(x @ weight.T + offset, 0)
        weight, offset = self.layers[-1]
        return x @ weight.T + offset

    @classmethod
    def initial(cls, widths: tuple[int, ...], rng: np.random.Generator) -> Network:
        """Return a network with random layers of these widths."""
        layers = tuple(
            (
                (np.sqrt(2 / a) * rng.standard_normal((b, a))).astype(np.float32),
                np.zeros(b, np.float32),
            )
            for a, b in zip(widths, widths[1:], strict=False)
        )
        return cls(layers)

    def _gradients(self, x: Array, slope: Callable[[Array], Array]) -> list[Layer]:
        """Return the derivatives of a loss by the layers. `slope` returns those by the outputs (n,
        m)."""
        values = [x]
        for weight, offset in self.layers[:-1]:
            values.append(np.maximum(values[-1] @ weight.T + offset, 0))
        weight, offset = self.layers[-1]
        back = slope(values[-1] @ weight.T + offset)
        found: list[Layer] = []
        for (weight, _), value in zip(self.layers[::-1], values[::-1], strict=True):
            found.append((back.T @ value, back.sum(axis=0)))
            back = (back @ weight) * (value > 0)
        return found[::-1]


def train(
    network: Network,
    inputs: Callable[[np.random.Generator], Array],
    slope: Callable[[Array, Array], Array],
    rounds: int,
    rng: np.random.Generator,
) -> Iterator[Network]:
    """Fit a network, and yield it after each round over the samples.

    Args:
        network: Initial network.
        inputs: Function that returns the inputs (n, k) of a round, with new noise.
        slope: Derivative of the loss by the outputs (b, m) of the samples with these indices (b,).
        rounds: Number of rounds.
        rng: Source of the order of the samples and of the noise.
    """
    parameters = [array for layer in network.layers for array in layer]
    first = [np.zeros_like(array) for array in parameters]
    second = [np.zeros_like(array) for array in parameters]
    step = 0
    for round_ in range(rounds):
        x = inputs(rng).astype(np.float32)
        rate = _RATE[0] * (_RATE[1] / _RATE[0]) ** (round_ / max(rounds - 1, 1))
        order = rng.permutation(len(x))
        for start in range(0, len(x), _BATCH):
            chosen = order[start : start + _BATCH]
            now = Network(_paired(parameters))
            layers = now._gradients(x[chosen], lambda y, at=chosen: slope(y, at))
            step += 1
            corrected = rate * np.sqrt(1 - _MOMENTS[1] ** step) / (1 - _MOMENTS[0] ** step)
            gradients = [array for layer in layers for array in layer]
            for value, g, m, v in zip(parameters, gradients, first, second, strict=True):
                m += (1 - _MOMENTS[0]) * (g - m)
                v += (1 - _MOMENTS[1]) * (g * g - v)
                value -= (corrected * m / (np.sqrt(v) + _TINY)).astype(np.float32)
        yield Network(_paired(parameters))


def _paired(arrays: list[Array]) -> tuple[Layer, ...]:
    return tuple(zip(arrays[::2], arrays[1::2], strict=True))
