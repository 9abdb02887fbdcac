"""Friction is tried before it is relied on: the grip loosens for a moment, close over the table,
where a slip costs nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Touch
from mjtactile.grasp_estimation.touch_statics import shear

_LOOSE = 0.75  # of the grip meanwhile: what passes holds with a third to spare
_TIME = 0.4  # s, of which a command takes 0.12 to be felt
_MEDIAN_OF = 3  # images at the beginning, which is before that, and at the end: one may err
_LOOSER = 0.05  # of the grip: less of a change says nothing
_KEPT = 0.88  # of the shear at the end: what slips loses a fifth, or all of it, on the table
_STEP = 1.25  # from a friction that has passed to the next one
_SLIP_FRACTION = 0.9  # of the ratio at which it slips
_SHOWN = 0.9  # of what is tried, in use at the end: less, and the grip could not be loosened so far
_MOST = 1.0  # as much as is ever believed, and as little
_LEAST = 0.2


@dataclass(frozen=True)
class FrictionProbe:
    """A controller keeps it as numbers (`vars`) and takes it up again
    (`FrictionProbe(**kept)`).

    Attributes:
        friction: What is tried now, and in the end the coefficient to go by.
        passed: The largest shear over normal force that has held so far; 0: nothing yet.
        first: What was believed before; less is not, unless it slips.
        press, drag: N, the mean grip and the mean shear in each image of this try.
        begun, slipped, over: Where it stands; who `slipped` may stand on the table again.
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
        """Whether friction is being tried."""
        return self.begun and not self.over

    @property
    def grip(self) -> float:
        """Share of the grip that is asked for now."""
        return _LOOSE if self.is_on else 1.0

    def after(self, touch: Sequence[Touch], period: float, believed: float = 0.0) -> FrictionProbe:
        """Take in one image, while what is gripped hangs low and nobody moves it.

        What sticks carries its load with the looser grip, too, and a higher friction is tried;
        what slips is dragged by friction alone, which follows the grip. A hold shows as much
        friction as was in use (Coulomb: shear <= mu normal force), whatever was meant to be: what
        is light uses little of it at the least grip that there is. Where all fingers say that they
        slip, that was all that there is.

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
            first = self.first if self.begun else max(self.friction, min(believed, _MOST))
            friction = self.friction if self.begun else first
            return replace(self, friction=friction, first=first, press=press, drag=drag, begun=True)
        ended = replace(self, press=(), drag=())
        looser = 1 - _last(press) / _first(press)
        if looser < _LOOSER:  # the grip could not be changed: nothing is known
            return replace(ended, friction=max(self.passed, self.first), over=True)
        if _last(drag) < _KEPT * _first(drag):  # what slides is dragged by less than its load
            ratio = float(np.max(np.asarray(drag) / np.asarray(press)))
            found = max(self.passed, min(self.friction, _SLIP_FRACTION * ratio), _LEAST)
            return replace(ended, friction=found, slipped=True, over=True)
        shown = _last(drag) / _last(press)
        passed = max(self.passed, min(shown, self.friction))
        if shown < _SHOWN * self.friction or self.friction >= _MOST:
            slides = all(one.slip is not None and one.slip.state == "slipping" for one in touch)
            believed = passed if slides else max(passed, self.first)
            return replace(ended, passed=passed, friction=believed, slipped=slides, over=True)
        return replace(ended, passed=passed, friction=min(_MOST, _STEP * self.friction))


def _first(values: Sequence[float]) -> float:
    return float(np.median(values[:_MEDIAN_OF]))


def _last(values: Sequence[float]) -> float:
    return float(np.median(values[-_MEDIAN_OF:]))
