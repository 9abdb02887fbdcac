"""What a hand believes of friction, from one image to the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Touch
from mjtactile.grasp_estimation.touch_statics import friction, shear

# Tried in simulation (docs/how-to/controllers.md). s that a slip is said late, and within which all
# fingers must say it; s until it counts again, and until a proof is forgotten (things get wet)
_LATE = 0.2
_TOGETHER = 0.3
_PAUSE = 0.4
_PROOF_TIME = 10.0
_NEAR = 0.85  # of what is believed: there one finger is enough
_SLIP_FRACTION = 0.85  # of the ratio at which it slipped: what is believed then,
_STEP = 0.8  # but no less than this of what was: a sign of slip may be wrong
_PROOF_FRACTION = 0.9
# After a sign of slip the grip is tightened. Whether the shear came along shows what it was worth
_VERDICT = 0.3  # s after it
_TREND = 0.15  # s over which a load that grows by itself is seen to
_HARDER = 1.15  # the grip must have grown by, to tell
_FOLLOWS = 0.35  # of the grip's growth in the shear: less is no slip
_RESTORED = 0.95  # of what was believed before, then
_GROWTH = 0.03  # 1/s, where the grip goes by what is believed, and no further than _UNPROVEN
_ASKED = 0.6  # of it in use: else a lighter grip is not for the asking, and a hold shows nothing
_UNPROVEN = 0.7
_FRICTION_MIN = 0.2
_FRICTION_MAX = 1.0  # rougher than that is not believed: rolling lets go before sliding does


@dataclass(frozen=True)
class FrictionEstimator:
    """A controller keeps it as numbers (`vars`) and takes it up again
    (`FrictionEstimator(**kept)`).

    Attributes:
        friction: The coefficient that is believed.
        proven: What it held at, of late: no sign of slip, while a grip changes, counts against it.
        used: The largest shear over normal force of the last moment: a slip is said late.
        since_slip: s since the last slip that was believed.
        slip_ages: s since each finger said that it slips.
        before: What was believed before that slip; 0 where it has been settled what it was worth.
        press: N, the mean grip at that slip.
        drag: N, the mean shear, as far as it would have come by itself when the verdict is due.
        slow: N, the mean shear of a moment ago.
        at: What was used at that slip.
        wrong: A sign of slip with no more than this in use was wrong, of late.
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
        """Whether a slip was believed in this very image."""
        return self.since_slip == 0.0

    def after(self, touch: Sequence[Touch], period: float) -> FrictionEstimator:
        """Take in one image.

        A slip that all fingers say within 0.3 s, or one near the friction that is believed, shows
        what friction is (one finger alone may roll or lean); not again for 0.4 s, in which the
        grip follows, nor where less is in use than what it held at of late. Shear that does not
        grow with that grip was carried by what sticks: then most of what was believed is believed
        again, and the next sign counts where more is in use than at that one. A second without any
        slip, and the belief grows by 3 % a second, as far as it is put to use.

        Args:
            touch: What is felt now.
            period: s since the image before.

        Returns:
            What is believed now.
        """
        told = friction(touch)
        used = max(float(np.nan_to_num(told.used).max()), self.used * math.exp(-period / _LATE))
        proven = self.proven * math.exp(-period / _PROOF_TIME)
        since_slip = self.since_slip + period
        if math.isnan(told.slipped) and since_slip > _PAUSE:
            proven = max(proven, told.least)
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
        """s since each finger said that it slips."""
        before = self.slip_ages or [1.0] * len(touch)
        slips = [one.slip is not None and one.slip.state == "slipping" for one in touch]
        return [0.0 if now else age + period for now, age in zip(slips, before, strict=True)]

    def _was_carried(self, touch: Sequence[Touch]) -> bool:
        """Whether the shear at the last sign of slip was a load, since it has not grown with the
        grip; False where the grip has not grown, or nothing is known."""
        press, drag = _means(touch)
        if not (press > _HARDER * self.press > 0 and self.drag > 0):
            return False
        return drag / self.drag - 1 < _FOLLOWS * (press / self.press - 1)


def _means(touch: Sequence[Touch]) -> tuple[float, float]:
    """N, over the fingers: how hard they press, and what drags at them."""
    press = float(np.mean([one.force_normal for one in touch]))
    return press, float(np.linalg.norm(shear(touch), axis=1).mean())
