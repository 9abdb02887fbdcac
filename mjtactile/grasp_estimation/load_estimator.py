"""What hangs on a grip, from one image to the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation.touch_statics import GRAVITY, downward, load_vector, shear

_KEPT = 1.5  # s in which a load that has gone is forgotten: half of a shake is light
_SPARE = 0.02  # N of shear beside what is felt: its noise, and what begins to come on
_LEAD = 0.15  # s ahead that a growing load is reckoned: what a grip needs to follow
_WEIGHING = 0.7  # s over which a weight is averaged


@dataclass(frozen=True)
class LoadEstimator:
    """A controller keeps it as numbers (`vars`) and takes it up again
    (`LoadEstimator(**kept)`).

    Attributes:
        most: N on each finger, along it: what it carries, and did of late.
        ahead: N, what it will carry at once.
        past: N, what it carried a moment ago; negative: nothing is known of that.
        down: (n, 2) where the load drags each finger; empty until it hangs on the fingers alone.
        mass: kg, averaged; 0 until it hangs.
        inner: (n, 2) of each newton of grip, what the fingers drag each other by; empty: unknown.
        last: N, what the image before showed alone; negative: there was none.
    """

    most: float = 0.0
    ahead: float = 0.0
    past: float = -1.0
    down: Sequence[Sequence[float]] = ()
    mass: float = 0.0
    inner: Sequence[Sequence[float]] = ()
    last: float = -1.0

    @property
    def worst(self) -> float:
        """N on each finger that it must be gripped for."""
        return max(self.most, self.ahead) + _SPARE

    def standing(self, touch: Sequence[Touch]) -> LoadEstimator:
        """It is gripped, and stands yet: what the fingers do to each other, they do already.

        Faces that stand askew are dragged along by closing, and the more so the harder they are
        gripped. What is pushed over its place drags, too, but then one finger presses harder than
        the other, and that part goes when it is lifted.

        Args:
            touch: What is felt now.

        Returns:
            The load, which knows now what part of the shear is none.
        """
        press = np.array([one.force_normal for one in touch])
        drag = shear(touch)
        pushed = float(np.ptp(press))
        trust = max(0.0, 1.0 - pushed / max(float(np.linalg.norm(drag, axis=1).mean()), 1e-9))
        return replace(self, inner=(trust * drag / max(float(press.mean()), 1e-9)).tolist())

    def hanging(self, touch: Sequence[Touch]) -> LoadEstimator:
        """From now on the fingers alone carry it.

        Args:
            touch: What is felt now.

        Returns:
            The load, which knows now where down is.
        """
        press = float(np.mean([one.force_normal for one in touch]))
        before = press * np.asarray(self.inner) if len(self.inner) else 0.0
        return replace(self, down=downward(touch, before).tolist())

    def vector(self, touch: Sequence[Touch]) -> Array:
        """Say with how much the world pulls at what hangs.

        Args:
            touch: What is felt now.

        Returns:
            (3,) N, as `load_vector` has it.
        """
        return load_vector(touch, np.asarray(self.down))

    def after(self, touch: Sequence[Touch], period: float) -> LoadEstimator:
        """Take in one image.

        It grows with what two images show, and once it hangs is gripped for what it is on its way
        to (before, it comes as the hand lets it, which waits for its grip); it goes slowly, but
        what was only on its way is not kept. One image alone may err by half of a load, which would
        be gripped for a second and a half. Once it hangs, what the fingers do to each other is no
        load, nor is what pushes it up; a slip lets go of what they did.

        Args:
            touch: What is felt now.
            period: s since the image before.

        Returns:
            The load now.
        """
        mass = self.mass
        if len(self.down):
            carried = self.vector(touch)
            carried[0] = max(carried[0], 0.0)  # upward it is the table's hand
            now = float(np.linalg.norm(carried[:2])) / len(touch)
            found = float(carried[0]) / GRAVITY
            mass = mass + period / _WEIGHING * (found - mass) if mass else found
        else:
            now = float(np.linalg.norm(shear(touch), axis=1).mean())
        sure = now if self.last < 0 else min(now, self.last)
        past = sure if self.past < 0 else self.past + min(1.0, period / _LEAD) * (sure - self.past)
        ahead = sure + (max(sure - past, 0.0) if len(self.down) else 0.0)
        most = max(sure, self.most * math.exp(-period / _KEPT))
        slips = all(one.slip is not None and one.slip.state == "slipping" for one in touch)
        inner = () if slips else self.inner
        return LoadEstimator(most, ahead, past, self.down, mass, inner, now)
