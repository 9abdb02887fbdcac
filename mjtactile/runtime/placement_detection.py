"""Detection of placement: a gripper that moves down must stop when the held object stands.

The object stands when the estimated load shows support by the table. It also stands when the
remaining height is at most the distance that it had slipped in the grip. Further down, the fingers
would be dragged over it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation import shear, support_force

_TABLE_FORCE = 0.3  # minimum support per finger, N; a nudge on the way down is less
_FOLLOWS = 0.2  # weight of a new shear sample in the low-pass filter of the load
_UP = 2e-3  # minimum gripper height for a suspended load, m


class SuspendedLoad:
    """Load on the fingers while the gripper is up and does not move down."""

    def __init__(self) -> None:
        self._shear: Array | None = None
        self._slid = 0.0
        self._height = 0.0

    def note(self, touch: Sequence[Touch], height: float) -> None:
        """Store the load of a cycle with the gripper at `height`, m."""
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
        """Return True if the held object stands, with the gripper at `height`, m, on its way
        down."""
        if height <= self._slid:
            return True
        return self._shear is not None and support_force(touch, self._shear) > _TABLE_FORCE
