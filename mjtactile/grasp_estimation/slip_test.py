"""Slip test: vary the grip slightly and check if the shear follows.

A sticking contact carries its load independent of the grip. The shear of a slipping contact is
friction alone, mu N, and follows the grip. This holds for any shape, also if the touch itself does
not change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Array


@dataclass(frozen=True)
class SlipTestResult:
    """Dependence of the shear on the grip.

    Attributes:
        fraction: Relative change of shear over that of the normal force: 0 sticks, 1 slips; NaN if
            the grip change was too small.
        sd: Its standard deviation.
    """

    fraction: float
    sd: float


UNKNOWN = SlipTestResult(math.nan, math.nan)
_MOMENTS_MIN = 4
_CHANGE_MIN = 0.01  # threshold, rms, as a fraction of the normal force; less is noise


@validated()
def evaluate_slip_test(normal: ArrayLike, shear: ArrayLike) -> SlipTestResult:
    """Test one finger, or the mean of several.

    Args:
        normal: (k,) Normal force over the last moments, equally spaced in time, with a varied grip,
            N.
        shear: (k,) Shear along the load, or its magnitude, N.

    Returns:
        The fraction of the shear that follows the grip, by least squares with a linear load trend.
        Its sd is computed from the residuals.
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
    fraction = float(press @ drag) / power
    left = drag - fraction * press
    sd = math.sqrt(float(left @ left) / (count - 3) / power)
    return SlipTestResult(fraction, sd)


def _without_trend(values: Array) -> Array:
    """Subtract mean and linear trend."""
    time = np.linspace(-1.0, 1.0, len(values))
    return values - values.mean() - time * float(time @ values) / float(time @ time)
