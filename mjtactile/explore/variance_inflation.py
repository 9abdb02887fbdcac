"""How much wider than it says a surface's doubt has to be: by what each touch was off from what all
others foretold (docs/theory/exploration.md, Eq. E6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve

from mjtactile.core.types import Array

_BEFORE = 2.0  # touches, that count as foretold as well as was said, before there was any
_BETWEEN = 2.0  # by which an excess counts: no touch is at an edge, where it is largest


def excess(
    factor: tuple[Array, bool], expected: Array, noise: Array, said: Array, parts: Sequence[slice]
) -> float:
    """By what the variances of a Gaussian surface are to be multiplied.

    A body that is of the wrong family, or touches that are wrong together, leave it as sure as the
    right ones do: covariances do not look at what was measured. What a touch finds where the others
    had said what it will find does.

    Args:
        factor: Of the covariance of the points' distances (`cho_factor`), (N, N) mm^2.
        expected: (N,) mm, their distances less what was expected before any touch.
        noise: (N, N) mm^2, of the points, as far as they are believed.
        said: (M, M) mm^2, of those that were touched, the first ones, as the touches said it.
        parts: The points of each touch.

    Returns:
        1 and twice what the mean square of the touches' heights, less what all others foretell, in
        its own sd, is beyond 1; nearer to 1 where touches are few.
    """
    inverse = cho_solve(factor, np.eye(len(expected)))
    pulls = inverse @ expected
    squares = [_square(part, inverse, pulls, noise, said) for part in parts]
    mean = (_BEFORE + sum(squares)) / (_BEFORE + len(squares))
    return 1.0 + _BETWEEN * max(mean - 1.0, 0.0)


def _square(part: slice, inverse: Array, pulls: Array, noise: Array, said: Array) -> float:
    """Of a touch's mean height, in sd of what the others leave open and of its own."""
    within = np.linalg.inv(inverse[part, part])  # its covariance, given all others
    miss = float((within @ pulls[part]).mean())
    foretold = max(float((within - noise[part, part]).mean()), 0.0)
    own = float(said[part, part].mean())
    return miss**2 / (foretold + own)
