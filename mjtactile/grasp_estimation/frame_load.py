"""Load on the fingers' frames: no membrane measures it, and a larger jaw force does not increase
the grip."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Touch

_ERROR = 0.3  # relative error of an effort: a data sheet's torque, the current's resolution
_GEARS = 1.0  # maximum friction force of the jaws, N
# minimum duration, s: an image is older than a current, and stopping jaws push for a moment
_LASTS = 0.2
_LOOSER = 0.8  # fraction of the grip measured then, to release the frames
_GROWTH = 0.05  # 1/s: who was wrong grips as hard as before in the end


@dataclass(frozen=True)
class FrameLoadEstimator:
    """Estimator of an object part wedged between the fingers' frames.

    An object base wider than the tips stands between the frames. The jaws push the frames against
    it. The wedged part also loads the membranes in shear, which resembles twice the weight. A
    controller stores it as plain values (`vars`) and restores it (`FrameLoadEstimator(**kept)`).

    Attributes:
        maximum: Largest useful grip force on each finger, N.
        time: Time since the servo force exceeds the measured contact force, s.
    """

    maximum: float = 100.0
    time: float = 0.0

    def after(self, touch: Sequence[Touch], effort: float, period: float) -> FrameLoadEstimator:
        """Update with one image.

        Args:
            touch: Current touches.
            effort: `observation.gripper.effort`, N on each finger; NaN if it is unknown.
            period: Time since the previous image, s.

        Returns:
            The updated estimator.
        """
        press = float(np.mean([one.force_normal for one in touch]))
        beyond = (1 - _ERROR) * effort - press - _GEARS
        if not (math.isfinite(beyond) and beyond > 0):
            return FrameLoadEstimator(self.maximum * (1 + _GROWTH * period))
        time = self.time + period
        return FrameLoadEstimator(
            min(self.maximum, _LOOSER * press) if time > _LASTS else self.maximum, time
        )
