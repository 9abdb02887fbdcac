"""Splines in one dimension; products of these bases form all two-dimensional bases.

`Cubic` are the clamped cubic B-splines that vanish at both ends. `hats` are piecewise linear.
`interpolating` passes through given values.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.types import Array

_DEGREE = 3


class Cubic:
    """Cubic B-splines on [-length/2, length/2] over `spans` equal intervals.

    The two that do not vanish at the ends are omitted; `count` = spans + 1 remain.

    `breaks` (spans + 1,) are the ends of the intervals. `points` and `weights` (spans * gauss,) are
    Gauss-Legendre quadrature with `gauss` nodes in each interval. It is exact up to degree 2 gauss
    - 1.
    """

    def __init__(self, length: float, spans: int, gauss: int):
        self.length = length
        self.spans = spans
        self.count = spans + _DEGREE - 2
        self.breaks = np.linspace(-length / 2, length / 2, spans + 1)
        self._knots = np.r_[[self.breaks[0]] * _DEGREE, self.breaks, [self.breaks[-1]] * _DEGREE]
        node, weight = np.polynomial.legendre.leggauss(gauss)
        half = length / spans / 2
        self.points = ((self.breaks[:-1] + half)[:, None] + half * node).ravel()
        self.weights = np.tile(half * weight, spans)

    def at(self, x: ArrayLike, derivative: int = 0) -> Array:
        """Evaluate the splines, or a derivative, (N, count) at `x` (N,), clipped to the
        interval."""
        x = np.clip(np.asarray(x, dtype=float), -self.length / 2, self.length / 2)
        return _basis(self._knots, x, derivative)[:, 1:-1]


def hats(knots: Array, at: Array) -> tuple[Array, Array]:
    """Return values and slopes (len(at), len(knots)) of piecewise linear hats on evenly spaced
    `knots`."""
    step = knots[1] - knots[0]
    distance = (at[:, None] - knots) / step
    inside = np.abs(distance) < 1
    return np.where(inside, 1 - np.abs(distance), 0.0), np.where(
        inside, -np.sign(distance) / step, 0.0
    )


def interpolating(knots: Array, at: Array) -> tuple[Array, Array]:
    """Return two matrices (N, n) that evaluate the cubic through values at `knots`.

    They map these values to values and slopes at `at`. The end condition is not-a-knot.
    """
    knot_vector = np.r_[[knots[0]] * (_DEGREE + 1), knots[2:-2], [knots[-1]] * (_DEGREE + 1)]
    coefficients = np.linalg.inv(_basis(knot_vector, knots))
    return _basis(knot_vector, at) @ coefficients, _basis(knot_vector, at, 1) @ coefficients


def _basis(knots: Array, x: Array, derivative: int = 0) -> Array:
    """Return the values or derivatives (N, n) of n cubic B-splines at `x` (N,).

    `knots` has shape (n + 4,). The method is de Boor's recursion (A Practical Guide to Splines, IX
    (14) and X (15)). The version in scipy takes a tenth of a second to import.
    """
    inside = np.clip(np.searchsorted(knots, x, side="right") - 1, _DEGREE, len(knots) - _DEGREE - 2)
    values = np.zeros((len(x), len(knots) - 1))
    values[np.arange(len(x)), inside] = 1.0
    for degree in range(1, _DEGREE + 1):
        width = knots[degree:] - knots[:-degree]
        over = np.divide(1.0, width, out=np.zeros_like(width), where=width > 0)
        up = over[:-1] * values[:, :-1]
        down = over[1:] * values[:, 1:]
        if degree <= _DEGREE - derivative:
            values = (x[:, None] - knots[: -degree - 1]) * up + (
                knots[degree + 1 :] - x[:, None]
            ) * down
        else:
            values = degree * (up - down)
    return values
