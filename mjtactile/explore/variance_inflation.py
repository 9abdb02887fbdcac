"""Variance inflation of an estimated surface by leave-one-out errors (docs/theory/exploration.md,
Eq. E6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve

from mjtactile.core.types import Array

_BEFORE = 2.0  # prior weight, in touches with a prediction error of 1 sd
_BETWEEN = 2.0  # by which an excess counts: no touch is at an edge, where it is largest


def excess(
    factor: tuple[Array, bool], expected: Array, noise: Array, said: Array, parts: Sequence[slice]
) -> float:
    """Compute the variance inflation factor of a Gaussian surface.

    The posterior covariance does not depend on the measured values. A wrong shape family, or a
    common error of the touches, therefore does not change it. The error of predicting each touch
    from the others does depend on them.

    Args:
        factor: Cholesky factor of the covariance of the points' distances (`cho_factor`), (N, N)
            mm^2.
        expected: (N,) Distances minus their prior mean, mm.
        noise: (N, N) Covariance of the points with inflated outliers, mm^2.
        said: (M, M) Covariance reported by the touches for the touched points, the first M, mm^2.
        parts: Point ranges of each touch.

    Returns:
        1 plus twice the excess over 1 of the mean square prediction error. The error is the height
        of a touch minus its prediction from all others, in sd. With few touches the factor is
        closer to 1.
    """
    inverse = cho_solve(factor, np.eye(len(expected)))
    pulls = inverse @ expected
    squares = [_square(part, inverse, pulls, noise, said) for part in parts]
    mean = (_BEFORE + sum(squares)) / (_BEFORE + len(squares))
    return 1.0 + _BETWEEN * max(mean - 1.0, 0.0)


def _square(part: slice, inverse: Array, pulls: Array, noise: Array, said: Array) -> float:
    """Return the squared prediction error of a touch's mean height. It is normalized by the
    prediction variance plus the touch's own variance."""
    within = np.linalg.inv(inverse[part, part])  # its covariance, given all others
    miss = float((within @ pulls[part]).mean())
    foretold = max(float((within - noise[part, part]).mean()), 0.0)
    own = float(said[part, part].mean())
    return miss**2 / (foretold + own)
