"""When a hand that goes down must stop, since what it holds stands already: by what is felt, as the
table pushes back, or by how far it had slid down in the grip. Further down, the fingers would be
dragged over it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation import shear, support

_TABLE_FORCE = 0.3  # N on each finger, beyond what the load was: a nudge on the way down is less
_FOLLOWS = 0.2  # of a new shear in what is taken for the load's, against noise
_UP = 2e-3  # m of the hand, from where on what it holds hangs on the fingers


class SuspendedLoad:
    """What hangs on the fingers while the hand is up and does not go down."""

    def __init__(self) -> None:
        self._shear: Array | None = None
        self._slid = 0.0
        self._height = 0.0

    def note(self, touch: Sequence[Touch], height: float) -> None:
        """Keep what was felt in a cycle with the hand at `height` m."""
        goes_down = height < self._height
        self._height = height
        if height < _UP or goes_down:
            return
        slid = [one.slip.distance for one in touch if one.slip is not None]
        if slid and math.isfinite(min(slid)):
            self._slid = min(slid)
        now = shear(touch)
        if math.isfinite(now.sum()):
            before = now if self._shear is None else self._shear
            self._shear = before + _FOLLOWS * (now - before)

    def stands(self, touch: Sequence[Touch], height: float) -> bool:
        """Whether what hung there stands on something, with the hand at `height` m on its way
        down."""
        if height <= self._slid:
            return True
        return self._shear is not None and support(touch, self._shear) > _TABLE_FORCE
