"""Friction is tried before it is relied on: the grip loosens for a moment, close over the table,
where a slip costs nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Touch
from mjtactile.hold.felt import shear

_LOOSE = 0.75  # of the grip meanwhile: what passes holds with a third to spare
_TIME = 0.4  # s, of which a command takes 0.12 to be felt
_MEAN_OF = 3  # images at the beginning, which is before that, and at the end
_LOOSER = 0.05  # of the grip: less of a change says nothing
_SLIPS = 0.5  # of the change of the grip in the shear, halfway from what sticks to what slips
_STEP = 1.25  # from a friction that has passed to the next one
_SLIP_SHARE = 0.9  # of the ratio at which it slips
_MOST = 1.0  # as much as is ever believed, and as little
_LEAST = 0.2


@dataclass(frozen=True)
class Trial:
    """A controller keeps it as numbers (`dataclasses.asdict`) and takes it up again
    (`Trial(**kept)`).

    Attributes:
        friction: What is tried now, and in the end the coefficient to go by.
        passed: What has held so far; 0: nothing yet.
        press, drag: N, the mean grip and the mean shear in each image of this try.
        begun, slipped, over: Where it stands; who `slipped` may stand on the table again.
    """

    friction: float
    passed: float = 0.0
    press: Sequence[float] = ()
    drag: Sequence[float] = ()
    begun: bool = False
    slipped: bool = False
    over: bool = False

    @property
    def is_on(self) -> bool:
        """Whether friction is being tried."""
        return self.begun and not self.over

    @property
    def grip(self) -> float:
        """Share of the grip that is asked for now."""
        return _LOOSE if self.is_on else 1.0

    def after(self, touch: Sequence[Touch], period: float, believed: float = 0.0) -> Trial:
        """Take in one image, while what is gripped hangs low and nobody moves it.

        What sticks carries its load with the looser grip, too, and a higher friction is tried;
        what slips is dragged by friction alone, which follows the grip.

        Args:
            touch: What is felt now.
            period: s since the image before.
            believed: The coefficient that the grip has gone by until now: less is not tried.

        Returns:
            The trial now; `over` where there is nothing more to find out.
        """
        press = [*self.press, float(np.mean([one.force_normal for one in touch]))]
        drag = [*self.drag, float(np.linalg.norm(shear(touch), axis=1).mean())]
        if len(press) * period < _TIME:
            friction = self.friction if self.begun else max(self.friction, min(believed, _MOST))
            return replace(self, friction=friction, press=press, drag=drag, begun=True)
        ended = replace(self, press=(), drag=())
        looser = 1 - _last(press) / _first(press)
        if looser < _LOOSER:  # the grip could not be changed: nothing is known
            return replace(ended, friction=self.passed or self.friction, over=True)
        if 1 - _last(drag) / _first(drag) > _SLIPS * looser:
            ratio = float(np.max(np.asarray(drag) / np.asarray(press)))
            found = max(self.passed, min(self.friction, _SLIP_SHARE * ratio), _LEAST)
            return replace(ended, friction=found, slipped=True, over=True)
        if self.friction >= _MOST:
            return replace(ended, passed=self.friction, over=True)
        return replace(ended, passed=self.friction, friction=min(_MOST, _STEP * self.friction))


def _first(values: Sequence[float]) -> float:
    return float(np.mean(values[:_MEAN_OF]))


def _last(values: Sequence[float]) -> float:
    return float(np.mean(values[-_MEAN_OF:]))
