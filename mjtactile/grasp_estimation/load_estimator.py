"""Recursive estimate of the load on a grip, from image to image, and of the load on the fingers'
frames: no membrane measures it, and a larger jaw force does not increase the grip."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.signature_checks import not_below, validated
from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation.touch_statics import (
    GRAVITY,
    external_shear,
    load_direction,
    load_vector,
)

_KEPT = 1.5  # time constant of forgetting a past load, s: half of a shake is light
_SPARE = 0.02  # shear margin for noise and for the start of a load, N
_LEAD = 0.15  # prediction time of a growing load, s: the time that a grip needs to follow
_WEIGHING = 0.7  # averaging time of the mass, s


@dataclass(frozen=True)
class LoadEstimator:
    """Recursive load estimator.

    A controller stores it as plain values (`vars`) and restores it (`LoadEstimator(**kept)`).

    Attributes:
        maximum: Recent maximum of the shear load on each finger, N.
        ahead: Predicted load in the near future, N.
        past: Load a moment ago, N; negative: unknown.
        down: (n, 2) Direction of the load on each finger; empty until the fingers alone carry it.
        mass: Averaged mass, kg; 0 before lifting.
        last: Load in the previous image alone, N; negative: no image.
    """

    maximum: float = 0.0
    ahead: float = 0.0
    past: float = -1.0
    down: Sequence[Sequence[float]] = ()
    mass: float = 0.0
    last: float = -1.0

    @property
    def worst(self) -> float:
        """Load on each finger that the grip must hold, N."""
        return max(self.maximum, self.ahead) + _SPARE

    @validated(fingers=not_below(1), push=not_below(0), acceleration=not_below(0))
    def expected(self, fingers: int, push: float, acceleration: float) -> float:
        """Return the load on each finger with an announced push and acceleration from any side.

        A measured load includes those that act already, so they add to the weight alone.

        Args:
            fingers: Number of fingers.
            push: Maximum push on the object, N.
            acceleration: Maximum acceleration of the gripper, m/s^2.

        Returns:
            Load, N; at least `worst`.
        """
        weight = self.mass * GRAVITY / fingers + _SPARE if self.mass else self.worst
        inertia = weight * acceleration / GRAVITY
        return max(self.worst, math.hypot(weight, push / fingers, inertia))

    @validated()
    def hanging(self, touch: Sequence[Touch]) -> LoadEstimator:
        """Store the load direction. From now on the fingers alone carry the load.

        Args:
            touch: Current touches.

        Returns:
            The estimator with the downward direction.
        """
        return replace(self, down=load_direction(touch).tolist())

    @validated()
    def vector(self, touch: Sequence[Touch]) -> Array:
        """Return the external force on the hanging object.

        Args:
            touch: Current touches.

        Returns:
            (3,) Force, N, in the components of `load_vector`.
        """
        return load_vector(touch, np.asarray(self.down))

    @validated(period=not_below(0))
    def after(
        self, touch: Sequence[Touch], period: float, *, is_slipping: bool = False
    ) -> LoadEstimator:
        """Update with one image.

        The load increases only if two images confirm it, or if the object slides. A single image
        may have an error of half a load, which the grip would hold for 1.5 s. Once the object
        hangs, the grip also covers the predicted increase. Before that, the gripper waits for its
        grip, so the load grows no faster. The load decreases slowly. The predicted part is not
        retained. A sliding contact carries only its friction. The load does not decrease meanwhile.

        Internal shear between two opposite fingers is not load; once the object hangs, upward
        forces are not either.

        Args:
            touch: Current touches.
            period: Time since the previous image, s.
            is_slipping: True if the object slides.

        Returns:
            The updated estimator.
        """
        mass = self.mass
        if len(self.down):
            carried = self.vector(touch)
            carried[0] = max(carried[0], 0.0)  # an upward force is support by the table
            now = float(np.linalg.norm(carried[:2])) / len(touch)
            found = float(carried[0]) / GRAVITY
            mass = mass + period / _WEIGHING * (found - mass) if mass else found
        else:
            now = float(np.linalg.norm(external_shear(touch), axis=1).mean())
        sure = now if self.last < 0 or is_slipping else min(now, self.last)
        past = sure if self.past < 0 else self.past + min(1.0, period / _LEAD) * (sure - self.past)
        ahead = sure + (max(sure - past, 0.0) if len(self.down) else 0.0)
        kept = 1.0 if is_slipping else math.exp(-period / _KEPT)
        maximum = max(sure, self.maximum * kept)
        return LoadEstimator(maximum, ahead, past, self.down, mass, now)


_EFFORT_ERROR = 0.3  # relative error of an effort: a data sheet's torque, the current's resolution
_JAW_FRICTION = 1.0  # maximum friction force of the jaws, N
# minimum duration, s: an image is older than a current, and stopping jaws push for a moment
_MIN_DURATION = 0.2
_RELEASE_FRACTION = 0.8  # fraction of the grip measured then, to release the frames
_LIMIT_GROWTH = 0.05  # 1/s: after a false detection the grip recovers


@dataclass(frozen=True)
class FrameLoadEstimator:
    """Estimator of an object part wedged between the fingers' frames.

    An object base wider than the tips stands between the frames. The jaws push the frames against
    it. The wedged part also loads the membranes in shear, which resembles twice the weight. A
    controller stores it as plain values (`vars`) and restores it (`FrameLoadEstimator(**kept)`).

    Attributes:
        maximum: Largest useful grip force on each finger, N.
        time: Time since the servo force exceeds the measured contact force, s.
        press: Contact force at the start of that time, N.
    """

    maximum: float = 100.0
    time: float = 0.0
    press: float = 0.0

    @validated(period=not_below(0))
    def after(
        self, touch: Sequence[Touch], effort: float, period: float, *, is_slipping: bool = False
    ) -> FrameLoadEstimator:
        """Update with one image.

        The grip is released once, not further if the frames stay loaded: the object would fall. A
        sliding object needs more grip in any case.

        Args:
            touch: Current touches.
            effort: `observation.gripper.effort`, N on each finger; NaN if it is unknown.
            period: Time since the previous image, s.
            is_slipping: True if the object slides.

        Returns:
            The updated estimator.
        """
        press = float(np.mean([estimate.force_normal for estimate in touch]))
        beyond = (1 - _EFFORT_ERROR) * effort - press - _JAW_FRICTION
        if is_slipping:
            return FrameLoadEstimator()
        if not (math.isfinite(beyond) and beyond > 0):
            return FrameLoadEstimator(self.maximum * (1 + _LIMIT_GROWTH * period))
        time, press = self.time + period, self.press or press
        released = _RELEASE_FRACTION * press if time > _MIN_DURATION else math.inf
        return FrameLoadEstimator(min(self.maximum, released), time, press)
