"""What leans on the fingers' frames: no membrane feels it, and gripping harder grips no harder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Touch

_ERROR = 0.3  # of an effort: a data sheet's torque, the current's resolution
_GEARS = 1.0  # N that moving the jaws takes at most
_LASTS = 0.2  # s: an image is older than a current, and jaws that are stopped push for a moment
_LOOSER = 0.8  # of the grip that was felt then: so that the frames come free
_GROWTH = 0.05  # 1/s: who was wrong grips as hard as before in the end


@dataclass(frozen=True)
class FrameLoadEstimator:
    """A foot that is wider than the tips stands between the frames. The jaws push them against it,
    what is wedged off them drags at the membranes, and that feels like twice the weight. A
    controller keeps it as numbers (`vars`) and takes it up again (`FrameLoadEstimator(**kept)`).

    Attributes:
        most: N on each finger that is of use to grip with.
        time: s since which the servos have pushed more than the fingers feel.
    """

    most: float = 100.0
    time: float = 0.0

    def after(self, touch: Sequence[Touch], effort: float, period: float) -> FrameLoadEstimator:
        """Take in one image.

        Args:
            touch: What is felt now.
            effort: `observation.gripper.effort`, N on each finger; NaN where it is unknown.
            period: s since the image before.

        Returns:
            What is known now.
        """
        press = float(np.mean([one.force_normal for one in touch]))
        beyond = (1 - _ERROR) * effort - press - _GEARS
        if not (math.isfinite(beyond) and beyond > 0):
            return FrameLoadEstimator(self.most * (1 + _GROWTH * period))
        time = self.time + period
        return FrameLoadEstimator(
            min(self.most, _LOOSER * press) if time > _LASTS else self.most, time
        )
