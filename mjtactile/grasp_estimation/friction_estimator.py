"""Recursive estimate of the friction coefficient, from image to image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Touch
from mjtactile.grasp_estimation.touch_statics import estimate_friction, shear

# Tuned in simulation (docs/how-to/controllers.md). All in s: delay of a slip report; time within
# which all fingers must report it; pause until the next slip counts; time constant of forgetting a
# held ratio (surfaces may get wet)
_LATE = 0.2
_TOGETHER = 0.3
_PAUSE = 0.4
_PROOF_TIME = 10.0
_NEAR = 0.85  # fraction of the estimate above which one finger is sufficient
_SLIP_FRACTION = 0.85  # new estimate as a fraction of the ratio at the slip,
_STEP = 0.8  # but at least this fraction of the old one: a slip sign may be wrong
_PROOF_FRACTION = 0.9
# After a slip sign the grip is tightened. The change of the shear shows if the sign was correct
_VERDICT = 0.3  # time from the slip sign to this check, s
_TREND = 0.15  # time constant for the trend of a growing load, s
_HARDER = 1.15  # minimum growth of the grip for this check
_FOLLOWS = 0.35  # minimum ratio of shear growth to grip growth for a slip
_RESTORED = 0.95  # restored fraction of the previous estimate
_GROWTH = 0.03  # growth rate of an estimate in use, 1/s, up to _UNPROVEN
# minimum used fraction of the estimate for this growth; below it a lighter grip is not available,
# and holding is no evidence
_ASKED = 0.6
_UNPROVEN = 0.7
_FRICTION_MIN = 0.2
_FRICTION_MAX = 1.0  # upper limit of the estimate: rolling starts before sliding


@dataclass(frozen=True)
class FrictionEstimator:
    """Recursive friction estimator.

    A controller stores it as plain values (`vars`) and restores it (`FrictionEstimator(**kept)`).

    Attributes:
        friction: Estimated coefficient.
        proven: Ratio recently held without slip. A slip sign at a lower ratio, during a grip
            change, is rejected.
        used: Largest recent shear over normal force, since slip is reported late.
        since_slip: Time since the last accepted slip, s.
        slip_ages: Time since each finger's last slip report, s.
        before: Estimate before that slip; 0 once the slip is evaluated.
        press: Mean grip force at that slip, N.
        drag: Mean shear, extrapolated to the time of the evaluation without a grip change, N.
        slow: Low-pass filtered mean shear, N.
        at: Ratio in use at that slip.
        wrong: Ratio in use at a recent false slip sign; later signs must exceed it.
    """

    friction: float
    proven: float = 0.0
    used: float = 0.0
    since_slip: float = 1.0
    slip_ages: Sequence[float] = ()
    before: float = 0.0
    press: float = 0.0
    drag: float = 0.0
    slow: float = 0.0
    at: float = 0.0
    wrong: float = 0.0

    @property
    def has_slipped(self) -> bool:
        """True if a slip was accepted in the newest image."""
        return self.since_slip == 0.0

    def after(self, touch: Sequence[Touch], period: float) -> FrictionEstimator:
        """Update with one image.

        A slip gives the friction coefficient if all fingers report it within 0.3 s. One finger
        alone may roll or lean; its report counts only near the estimated friction. The next slip
        counts after 0.4 s, in which the grip is adjusted. It does not count below a ratio that was
        recently held.

        If the shear does not grow with the tighter grip, it was a load on a sticking contact. Most
        of the previous estimate is then restored, and the next sign must exceed that ratio. After a
        second without slip the estimate grows by 3 % per second, as long as it is in use.

        Args:
            touch: Current touches.
            period: Time since the previous image, s.

        Returns:
            The updated estimator.
        """
        told = estimate_friction(touch)
        used = max(float(np.nan_to_num(told.used).max()), self.used * math.exp(-period / _LATE))
        proven = self.proven * math.exp(-period / _PROOF_TIME)
        since_slip = self.since_slip + period
        if math.isnan(told.slipped) and since_slip > _PAUSE:
            proven = max(proven, told.minimum)
        ages = self._ages(touch, period)
        press = self.press
        drag = self.drag
        at = self.at
        wrong = self.wrong * math.exp(-period / _PROOF_TIME)
        before = self.before
        believed = self.friction
        alone = min(ages) == 0.0 and used > _NEAR * believed
        said = used > max(wrong, _PROOF_FRACTION * proven) and (max(ages) < _TOGETHER or alone)
        if since_slip >= _PAUSE and said:
            before = believed
            believed = min(believed, max(_SLIP_FRACTION * used, _STEP * believed, _FRICTION_MIN))
            press, drag = _means(touch)
            drag += max(drag - self.slow, 0.0) * _VERDICT / _TREND
            at = used
            since_slip = 0.0
        elif before and since_slip >= _VERDICT:
            if self._was_carried(touch):
                believed = max(believed, _RESTORED * before)
                wrong = max(wrong, at)
            before = 0.0
        elif since_slip > 1.0 and _ASKED * believed < used and believed < _UNPROVEN:
            believed *= 1 + _GROWTH * period
        believed = min(max(believed, _PROOF_FRACTION * proven), _FRICTION_MAX)
        slow = self.slow + min(1.0, period / _TREND) * (_means(touch)[1] - self.slow)
        return FrictionEstimator(
            believed, proven, used, since_slip, ages, before, press, drag, slow, at, wrong
        )

    def _ages(self, touch: Sequence[Touch], period: float) -> list[float]:
        """Return the time since each finger's last slip report, s."""
        before = self.slip_ages or [1.0] * len(touch)
        slips = [one.slip is not None and one.slip.state == "slipping" for one in touch]
        return [0.0 if now else age + period for now, age in zip(slips, before, strict=True)]

    def _was_carried(self, touch: Sequence[Touch]) -> bool:
        """Return True if the shear at the last slip sign was a load.

        A load does not grow with the grip. Return False if the grip has not grown, or if this is
        unknown.
        """
        press, drag = _means(touch)
        if not (press > _HARDER * self.press > 0 and self.drag > 0):
            return False
        return drag / self.drag - 1 < _FOLLOWS * (press / self.press - 1)


def _means(touch: Sequence[Touch]) -> tuple[float, float]:
    """Return the mean normal force and the mean shear of the fingers, N."""
    press = float(np.mean([one.force_normal for one in touch]))
    return press, float(np.linalg.norm(shear(touch), axis=1).mean())
