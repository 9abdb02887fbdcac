"""Estimated surface: a parametric shape and a residual field (docs/theory/exploration.md, Eq. E1 to
E3), and the inflation of its variance by leave-one-out errors (Eq. E6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve
from scipy.spatial.distance import cdist

from mjtactile.core.types import Array
from mjtactile.explore import superquadric
from mjtactile.explore.shape_models import FREE, ObjectFamily

_MM = 1e3
_BEFORE = 2.0  # prior weight, in touches with a prediction error of 1 sd
_BETWEEN = 2.0  # weight of an excess: no touch is at an edge, where it is largest
ALIKE = 0.04
"""Standard deviation of the error common to all touches, mm. It scales the whole object and is not
observable by comparing touches. The value holds for the shipped sensors, from sizes of eggs, vials
and random objects."""


@dataclass(frozen=True, eq=False)
class SurfacePosterior:
    """Posterior of an object's surface.

    Attributes:
        family: Shape model.
        theta: (14,) Shape parameters (`mjtactile.explore.superquadric.COUNT`).
        field: Standard deviation and correlation length of the additional field, mm.
        points: (N, 3) Touched points, mm.
        weights: (N,) Weights of the field's covariances with the points, 1/mm.
        factor: Cholesky factor of the covariance of the points' distances, with unknown shape
            parameters.
        log_evidence: Log evidence of shape and field.
        excess: Variance inflation factor (Eq. E6).
    """

    family: ObjectFamily
    theta: Array
    field: tuple[float, float]
    points: Array
    weights: Array
    factor: tuple[Array, bool]
    log_evidence: float
    excess: float = 1.0

    def distance(self, p: Array) -> Array:
        """Return the distance of points (N, 3), m, outside the surface, (N,) m; 0 on the
        surface."""
        across = kernel(_MM * p, self.points, *self.field)
        return (superquadric.distance(self.theta, _MM * p) + across @ self.weights) / _MM

    def distance_sd(self, p: Array) -> Array:
        """Return the standard deviation of the distance, (N,) m, with the error common to all
        touches."""
        p_mm = _MM * p
        rows = superquadric.jacobian(self.theta, p_mm)
        across = self._across(p_mm, rows)
        before = np.einsum("ni,ij,nj->n", rows, self.family.cov, rows) + self.field[0] ** 2
        known = np.einsum("nm,mn->n", across, cho_solve(self.factor, across.T))
        return np.sqrt(self.excess * np.maximum(before - known, 1e-8) + ALIKE**2) / _MM

    def distance_cov(self, p: Array, q: Array) -> Array:
        """Return the covariance (N, M), m^2, of the distances at points `p` and `q`. The error
        common to all touches is excluded, because another touch cannot reduce it."""
        p_mm, q_mm = _MM * p, _MM * q
        rows, others = (superquadric.jacobian(self.theta, at) for at in (p_mm, q_mm))
        before = rows @ self.family.cov @ others.T + kernel(p_mm, q_mm, *self.field)
        if not len(self.points):
            return self.excess * before / _MM**2
        known = self._across(p_mm, rows) @ cho_solve(self.factor, self._across(q_mm, others).T)
        return self.excess * (before - known) / _MM**2

    def _across(self, p_mm: Array, rows: Array) -> Array:
        """Return the covariance (N, M), mm^2, of the distances at points with the touched ones."""
        others = superquadric.jacobian(self.theta, self.points)
        return rows @ self.family.cov @ others.T + kernel(p_mm, self.points, *self.field)


def kernel(p: Array, q: Array, sd: float, length: float) -> Array:
    """Return the covariance (N, M) of the field at points; Matern of order 5/2."""
    if sd == 0:
        return np.zeros((len(p), len(q)))
    r = np.sqrt(5) * cdist(p, q) / length
    return sd**2 * (1 + r + r**2 / 3) * np.exp(-r)


def unknown() -> SurfacePosterior:
    """Return the prior before the first touch: a ball about the holder's origin."""
    none = np.zeros((0, 3))
    empty = (np.zeros((0, 0)), True)
    theta = FREE.mean.copy()
    theta[9:11] = 1.0
    return SurfacePosterior(FREE, theta, (0.3, 8.0), none, np.zeros(0), empty, 0.0)


def excess(
    factor: tuple[Array, bool], expected: Array, noise: Array, stated: Array, parts: Sequence[slice]
) -> float:
    """Compute the variance inflation factor of a Gaussian surface.

    The posterior covariance does not depend on the measured values. A wrong shape model, or a
    common error of the touches, therefore does not change it. The error of predicting each touch
    from the others does depend on them.

    Args:
        factor: Cholesky factor of the covariance of the points' distances (`cho_factor`), (N, N)
            mm^2.
        expected: (N,) Distances minus their prior mean, mm.
        noise: (N, N) Covariance of the points with inflated outliers, mm^2.
        stated: (M, M) Covariance reported by the touches for the touched points, the first M, mm^2.
        parts: Point ranges of each touch.

    Returns:
        1 plus twice the excess over 1 of the mean square prediction error. The error is the height
        of a touch minus its prediction from all others, in sd. With few touches the factor is
        closer to 1.
    """
    inverse = cho_solve(factor, np.eye(len(expected)))
    pulls = inverse @ expected
    squares = [_square(part, inverse, pulls, noise, stated) for part in parts]
    mean = (_BEFORE + sum(squares)) / (_BEFORE + len(squares))
    return 1.0 + _BETWEEN * max(mean - 1.0, 0.0)


def _square(part: slice, inverse: Array, pulls: Array, noise: Array, stated: Array) -> float:
    """Return the squared prediction error of a touch's mean height. It is normalized by the
    prediction variance plus the touch's own variance."""
    within = np.linalg.inv(inverse[part, part])  # its covariance, given all others
    miss = float((within @ pulls[part]).mean())
    predicted = max(float((within - noise[part, part]).mean()), 0.0)
    variance = float(stated[part, part].mean())
    return miss**2 / (predicted + variance)
