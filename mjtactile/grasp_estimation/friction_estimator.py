"""Recursive estimate of the friction coefficient, and a friction test before it is relied on: the
grip loosens briefly, close above the table, where a slip causes no damage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
        now = estimate_friction(touch)
        used = max(float(np.nan_to_num(now.used).max()), self.used * math.exp(-period / _LATE))
        proven = self.proven * math.exp(-period / _PROOF_TIME)
        since_slip = self.since_slip + period
        if math.isnan(now.slipped) and since_slip > _PAUSE:
            proven = max(proven, now.minimum)
        ages = self._ages(touch, period)
        press, drag, at = self.press, self.drag, self.at
        wrong = self.wrong * math.exp(-period / _PROOF_TIME)
        before = self.before
        friction = self.friction
        alone = min(ages) == 0.0 and used > _NEAR * friction
        slipped = used > max(wrong, _PROOF_FRACTION * proven) and (max(ages) < _TOGETHER or alone)
        if since_slip >= _PAUSE and slipped:
            before = friction
            friction = min(friction, max(_SLIP_FRACTION * used, _STEP * friction, _FRICTION_MIN))
            press, drag = _means(touch)
            drag += max(drag - self.slow, 0.0) * _VERDICT / _TREND
            at = used
            since_slip = 0.0
        elif before and since_slip >= _VERDICT:
            if self._was_carried(touch):
                friction = max(friction, _RESTORED * before)
                wrong = max(wrong, at)
            before = 0.0
        elif since_slip > 1.0 and _ASKED * friction < used and friction < _UNPROVEN:
            friction *= 1 + _GROWTH * period
        friction = min(max(friction, _PROOF_FRACTION * proven), _FRICTION_MAX)
        slow = self.slow + min(1.0, period / _TREND) * (_means(touch)[1] - self.slow)
        return FrictionEstimator(
            friction, proven, used, since_slip, ages, before, press, drag, slow, at, wrong
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


_PROBE_GRIP = 0.75  # grip during the test, as a fraction: a held ratio leaves a margin of one third
_PROBE_TIME = 0.4  # duration of a test, s, including the command delay of 0.12
_MEDIAN_OF = 3  # images at the beginning, which is before that, and at the end: one may err
_MIN_GRIP_CHANGE = 0.05  # minimum relative grip change for a result
# minimum remaining fraction of the shear: a slipping contact loses a fifth, or all of it on the
# table
_MIN_SHEAR_FRACTION = 0.88
_PROBE_STEP = 1.25  # from a friction that has passed to the next one
_PROBE_SLIP_FRACTION = 0.9  # of the ratio at which it slips
# minimum fraction of the tested ratio in use at the end; below it, the grip could not be loosened
# enough
_MIN_SHOWN = 0.9


@dataclass(frozen=True)
class FrictionProbe:
    """Friction test by a looser grip.

    A controller stores it as plain values (`vars`) and restores it (`FrictionProbe(**kept)`).

    Attributes:
        friction: Coefficient under test, and the result at the end.
        passed: Largest shear over normal force held so far; 0: none.
        first: Initial estimate, and lower limit of the result without slip.
        press, drag: Mean grip force and mean shear in each image of this test, N.
        begun, slipped, over: State of the test; after `slipped` the object may stand on the table
            again.
    """

    friction: float
    passed: float = 0.0
    first: float = 0.0
    press: Sequence[float] = ()
    drag: Sequence[float] = ()
    begun: bool = False
    slipped: bool = False
    over: bool = False

    @property
    def is_on(self) -> bool:
        """True during a friction test."""
        return self.begun and not self.over

    @property
    def grip(self) -> float:
        """Requested fraction of the grip force."""
        return _PROBE_GRIP if self.is_on else 1.0

    def after(self, touch: Sequence[Touch], period: float, believed: float = 0.0) -> FrictionProbe:
        """Update with one image, while the object hangs low above the table without motion.

        A sticking contact carries its load with the looser grip, too; then a higher friction is
        tested. The shear of a slipping contact is friction alone, and follows the grip. A hold
        proves only the ratio in use (Coulomb: shear <= mu normal force), not the intended one. A
        light object uses little of it even at the minimum grip. If all fingers report slip, that
        ratio is the limit.

        Args:
            touch: Current touches.
            period: Time since the previous image, s.
            believed: Coefficient used for the grip so far; lower values are not tested.

        Returns:
            The updated test; `over` when it is complete.
        """
        new_press, new_drag = _means(touch)
        press, drag = [*self.press, new_press], [*self.drag, new_drag]
        if len(press) * period < _PROBE_TIME:
            first = self.first if self.begun else max(self.friction, min(believed, _FRICTION_MAX))
            friction = self.friction if self.begun else first
            return replace(self, friction=friction, first=first, press=press, drag=drag, begun=True)
        ended = replace(self, press=(), drag=())
        looser = 1 - _last(press) / _first(press)
        if looser < _MIN_GRIP_CHANGE:  # the grip could not be changed: no result
            return replace(ended, friction=max(self.passed, self.first), over=True)
        if _last(drag) < _MIN_SHEAR_FRACTION * _first(
            drag
        ):  # the shear of a sliding contact is below its load
            ratio = float(np.max(np.asarray(drag) / np.asarray(press)))
            limit = min(self.friction, _PROBE_SLIP_FRACTION * ratio)
            found = max(self.passed, limit, _FRICTION_MIN)
            return replace(ended, friction=found, slipped=True, over=True)
        shown = _last(drag) / _last(press)
        passed = max(self.passed, min(shown, self.friction))
        if shown < _MIN_SHOWN * self.friction or self.friction >= _FRICTION_MAX:
            slides = all(one.slip is not None and one.slip.state == "slipping" for one in touch)
            believed = passed if slides else max(passed, self.first)
            return replace(ended, passed=passed, friction=believed, slipped=slides, over=True)
        friction = min(_FRICTION_MAX, _PROBE_STEP * self.friction)
        return replace(ended, passed=passed, friction=friction)


def _first(values: Sequence[float]) -> float:
    return float(np.median(values[:_MEDIAN_OF]))


def _last(values: Sequence[float]) -> float:
    return float(np.median(values[-_MEDIAN_OF:]))
