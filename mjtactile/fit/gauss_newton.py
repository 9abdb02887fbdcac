"""Gauss-Newton for models that take seconds per evaluation.

It needs few evaluations. The Jacobian steps are larger than the model's own noise. It ends when a
step is small relative to the parameter uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array

_ENOUGH = 0.1  # of a standard deviation: a last step
_HALVINGS = 3
_FLAT = 1e-3  # relative change of the sum of squares caused by simulation noise


@dataclass(frozen=True)
class Scale:
    """Scale of a parameter: its limits `low` and `high`, and its unknown x.

    x = log(value/nominal), or (value - nominal)/`unit` if `unit` is given. `step` is the step of x
    for a Jacobian.
    """

    low: float
    high: float
    unit: float = 0.0
    step: float = 0.02

    def value(self, x: float, nominal: float) -> float:
        value = nominal + self.unit * x if self.unit else nominal * math.exp(x)
        return min(max(value, self.low), self.high)

    def scaled(self, value: float, nominal: float) -> float:
        """x of a value."""
        return (value - nominal) / self.unit if self.unit else math.log(value / nominal)

    def slope(self, value: float) -> float:
        """d(value)/dx."""
        return self.unit or value


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters `x` (n,), the `jacobian` (r, n) near it and the residuals (r,) there, in sd."""

    x: Array
    jacobian: Array
    residuals: Array

    @property
    def information(self) -> Array:
        """Inverse of the covariance, (n, n)."""
        return self.jacobian.T @ self.jacobian


def gauss_newton(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array, Array], Array],
    x: Array,
    *,
    low: Array,
    high: Array,
    iterations: int = 6,
    enough: float = _ENOUGH,
) -> Solution:
    """Minimise the sum of squares from `x` within `low` and `high`; `jacobian(x, residuals(x))` (r,
    n). It ends when no step is longer than `enough` sd, or the sum falls no further."""
    now = residuals(x)
    for _ in range(iterations):
        J = jacobian(x, now)
        H = J.T @ J
        ridge = 1e-9 * np.diag(np.diag(H) + 1e-12)
        goal = np.clip(x - np.linalg.solve(H + ridge, J.T @ now), low, high)
        better = None
        sd = np.sqrt(np.diag(np.linalg.inv(H + ridge)))
        if np.all(np.abs(goal - x) < enough * sd):
            break
        for halving in range(_HALVINGS):
            there = x + (goal - x) / 2**halving
            found = residuals(there)
            if found @ found < now @ now:
                better = there, found
                break
        if better is None:
            break
        flat = now @ now - better[1] @ better[1] < _FLAT * (now @ now)
        x, now = better
        if flat:
            break
    # the loop runs at least once
    return Solution(x, J, now)  # pyright: ignore[reportPossiblyUnboundVariable]
