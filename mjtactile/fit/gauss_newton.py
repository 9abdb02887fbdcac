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

_ENOUGH = 0.1  # last step, as a fraction of a standard deviation
_NEAR = 3.0  # step, in sd, below which the Jacobian is kept
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
        """Return the unknown x of a value."""
        return (value - nominal) / self.unit if self.unit else math.log(value / nominal)

    def slope(self, value: float) -> float:
        """Return d(value)/dx."""
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
    start: Array | None = None,
) -> Solution:
    """Minimize the sum of squares from `x` within `low` and `high`.

    It ends when no step is longer than `enough` sd, or the sum falls no further. A step shorter
    than _NEAR keeps the Jacobian.

    Args:
        residuals: Residuals (r,), in sd, at parameters (n,).
        jacobian: Their derivatives (r, n), at parameters and residuals.
        x: Start (n,).
        low: Lower limits (n,).
        high: Upper limits (n,).
        iterations: Maximum number of steps.
        enough: Length of a negligible step, sd.
        start: Jacobian near `x`; None: computed.

    Returns:
        The parameters.
    """
    now = residuals(x)
    J = jacobian(x, now) if start is None else start
    is_new = start is None
    for _ in range(iterations):
        goal, longest = _step(J, x, now, low, high)
        if longest >= _NEAR and not is_new:
            J = jacobian(x, now)
            goal, longest = _step(J, x, now, low, high)
        is_new = False
        if longest < enough:
            break
        better = None
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
    return Solution(x, J, now)


def _step(J: Array, x: Array, now: Array, low: Array, high: Array) -> tuple[Array, float]:
    """Return the parameters after a Gauss-Newton step, and its longest component, sd."""
    H = J.T @ J
    inverse = np.linalg.inv(H + 1e-9 * np.diag(np.diag(H) + 1e-12))
    goal = np.clip(x - inverse @ (J.T @ now), low, high)
    return goal, float(np.max(np.abs(goal - x) / np.sqrt(np.diag(inverse))))
