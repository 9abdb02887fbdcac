"""The test for slip: grip a little harder and softer, and see whether the shear follows.

What sticks carries its load, whatever it is gripped with. What slips is dragged by friction alone,
and friction is mu N: it follows the grip, for any shape, also where the touch itself looks the same
before and after.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.types import Array


@dataclass(frozen=True)
class SlipTestResult:
    """How shear follows the grip.

    Attributes:
        share: Relative change of the shear over that of the normal force: 0 sticks, 1 slips; NaN
            where the grip did not change enough to tell.
        sd: Its standard deviation.
    """

    share: float
    sd: float


UNKNOWN = SlipTestResult(math.nan, math.nan)
_MOMENTS_MIN = 4
_CHANGE_MIN = 0.01  # of the normal force, rms: less is in its noise


def follows(normal: ArrayLike, shear: ArrayLike) -> SlipTestResult:
    """Test one finger, or the mean of several.

    Args:
        normal: (k,) N over the last moments, evenly in time, in which the grip was changed.
        shear: (k,) N along the load, or its magnitude.

    Returns:
        The share of shear that goes with the grip, by least squares beside a load that grows evenly
        in time, with the sd that is left by what neither explains.
    """
    press = np.asarray(normal, float)
    drag = np.asarray(shear, float)
    count = len(press)
    if count < _MOMENTS_MIN or not (np.isfinite(press).all() and np.isfinite(drag).all()):
        return UNKNOWN
    if press.mean() <= 0 or drag.mean() <= 0:
        return UNKNOWN
    press = press / press.mean() - 1
    drag = drag / drag.mean() - 1
    press = _without_trend(press)
    drag = _without_trend(drag)
    power = float(press @ press)
    if math.sqrt(power / count) < _CHANGE_MIN:
        return UNKNOWN
    share = float(press @ drag) / power
    left = drag - share * press
    sd = math.sqrt(float(left @ left) / (count - 3) / power)
    return SlipTestResult(share, sd)


def _without_trend(values: Array) -> Array:
    """Less mean and slope."""
    time = np.linspace(-1.0, 1.0, len(values))
    return values - values.mean() - time * float(time @ values) / float(time @ time)
