"""Active slip test, in addition to the passive slip indicators.

The grip changes by a twentieth at 4 Hz, and the shear of a slipping contact follows it. An
indicator counts unless the shear clearly stays constant.

Tested on seeds below the evaluation seeds, with 56 slips and 92 holds, and rejected: the test alone
(25-32 slips within 0.4 s, 9-40 false alarms: soft objects and loads that grow irregularly follow
the grip as well), and the test as a second indicator (24-32, 5-9 false, a window later).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.slip.evaluate_case import Sample
from mjtactile.core.types import Touch
from mjtactile.grasp_estimation import SlipTestResult, evaluate_slip_test

WINDOW = 0.3  # window, s: slightly more than one period
IN_TIME = 0.4  # time limit of a detection with the test, s
STAYS = 0.7  # relative shear response to the grip: no slip if smaller by two sd
_ARM = 3e-3  # lever arm in a contact, m, that converts a torque about its normal to a force


def vetoes(samples: Sequence[Sample]) -> list[bool]:
    """Return, for each image, True if the images of the last 0.3 s exclude slip."""
    return [sticks(found) for found in followings(samples)]


def followings(samples: Sequence[Sample]) -> list[SlipTestResult]:
    """Estimate up to each image how the shear, force and torque, followed the grip."""
    time = np.array([sample.time for sample in samples])
    normal = np.array([sample.touch.force_normal for sample in samples])
    shear = np.array([_shear(sample.touch) for sample in samples])
    starts = np.searchsorted(time, time - WINDOW - 1e-9)
    return [
        evaluate_slip_test(normal[start : k + 1], shear[start : k + 1])
        if time[k] - time[0] >= WINDOW - 1e-9
        else evaluate_slip_test([], [])
        for k, start in enumerate(starts)
    ]


def sticks(found: SlipTestResult) -> bool:
    """Return True if the shear clearly follows too little for a slip; False if unknown."""
    return found.fraction + 2 * found.sd < STAYS


def _shear(touch: Touch) -> float:
    """Return the shear force including the torque, N; NaN if unknown."""
    if touch.traction is None:
        return float("nan")
    wrench = touch.traction.wrench
    return float(np.linalg.norm([wrench[0], wrench[1], wrench[5] / _ARM]))
