"""Friction test before the controller relies on the friction.

The grip loosens briefly, close above the table, where a slip causes no damage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Touch
from mjtactile.grasp_estimation.touch_statics import shear

_LOOSE = 0.75  # grip during the test, as a fraction: a held ratio leaves a margin of one third
_TIME = 0.4  # duration of a test, s, including the command delay of 0.12
_MEDIAN_OF = 3  # images at the beginning, which is before that, and at the end: one may err
_LOOSER = 0.05  # minimum relative grip change for a result
# minimum remaining fraction of the shear: a slipping contact loses a fifth, or all of it on the
# table
_KEPT = 0.88
_STEP = 1.25  # from a friction that has passed to the next one
_SLIP_FRACTION = 0.9  # of the ratio at which it slips
# minimum fraction of the tested ratio in use at the end; below it, the grip could not be loosened
# enough
_SHOWN = 0.9
_MOST = 1.0  # upper and lower limit of the result
_LEAST = 0.2


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
        return _LOOSE if self.is_on else 1.0

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
        press = [*self.press, float(np.mean([one.force_normal for one in touch]))]
        drag = [*self.drag, float(np.linalg.norm(shear(touch), axis=1).mean())]
        if len(press) * period < _TIME:
            first = self.first if self.begun else max(self.friction, min(believed, _MOST))
            friction = self.friction if self.begun else first
            return replace(self, friction=friction, first=first, press=press, drag=drag, begun=True)
        ended = replace(self, press=(), drag=())
        looser = 1 - _last(press) / _first(press)
        if looser < _LOOSER:  # the grip could not be changed: no result
            return replace(ended, friction=max(self.passed, self.first), over=True)
        if _last(drag) < _KEPT * _first(drag):  # the shear of a sliding contact is below its load
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
