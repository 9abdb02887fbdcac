"""Set-down of a held object, from touch alone: one rule for control loop and scoring.

An object is set down if it stands when the fingers open: the table carries more than half of the
load that hung on the fingers (`mjtactile.grasp_estimation.stands`), or the gripper is at most
`RELEASE_HEIGHT` above the place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mjtactile.core.policy import DOWN
from mjtactile.core.types import Array, Command, Touch
from mjtactile.grasp_estimation import shear, stands, support_force

ENDS = ("done", "abort")  # phases
HEIGHT_TOLERANCE = 2e-4  # tolerance of a lowered gripper, m: a servo's goal is rounded to 0.1 mm
RELEASE_HEIGHT = DOWN  # maximum height at which a released object is set down, not dropped, m
_TABLE_FORCE = 0.3  # minimum support per finger, N; a nudge on the way down is less
_FOLLOWS = 0.2  # weight of a new shear sample in the low-pass filter of the load
_UP = 2e-3  # minimum gripper height for a suspended load, m


class SuspendedLoad:
    """Load on the fingers while the gripper is up and does not move down.

    A gripper that moves down must stop when the held object stands: the load shows support by the
    table, or the remaining height is at most the distance that the object had slipped in the grip.
    """

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
        slid = [estimate.slip.distance for estimate in touch if estimate.slip is not None]
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

    def is_on_table(self, touch: Sequence[Touch], height: float) -> bool:
        """Return True if the table carries more than half of the load, or the remaining `height`,
        m, is at most the slip distance or `RELEASE_HEIGHT`."""
        if height <= max(self._slid, RELEASE_HEIGHT):
            return True
        if self._shear is None:
            return False
        held = np.linalg.norm(self._shear, axis=1)
        direction = self._shear / np.maximum(held, 1e-9)[:, None]
        return stands(float((shear(touch) * direction).sum()), float(held.sum()))


class SafeSetDown:
    """Decision whether a run that ended early has set the object down. Call `watch` once per cycle.

    The retreat lowers the gripper and opens it. The object is set down if a finger was in contact
    until then, and the object stood.
    """

    def __init__(self, place_height: float = 0.0):
        self._place = place_height
        self._load = SuspendedLoad()
        self._opening = math.inf
        self._is_gripped = False
        self._is_open = False
        self.stood = False
        """True if the object stood when the fingers began to open."""

    def watch(self, touch: Sequence[Touch], command: Command) -> None:
        """Update with the touch of a cycle and the command that was sent in it."""
        opens = command.phase in ENDS and command.opening > self._opening
        self._opening = command.opening
        if self._is_open:
            return
        if opens:
            height = command.lift_height - self._place
            self.stood = self._is_gripped and self._load.is_on_table(touch, height)
            self._is_open = True
            return
        self._load.note(touch, command.lift_height)
        self._is_gripped = any(estimate.touching for estimate in touch)


class SetDown:
    """Decision about the set-down of one run. `watch` is called once per cycle."""

    def __init__(self, place_height: float = 0.0):
        self._place = place_height
        self._load = SuspendedLoad()
        self._is_released = False
        self.stood = False
        """True if the object stood when the fingers began to open."""

    def watch(self, touch: Sequence[Touch], command: Command) -> None:
        """Update with the touch of a cycle and the command that was sent in it."""
        was_released = self._is_released
        self._is_released = command.phase in ("release", *ENDS)
        if not self._is_released:
            self._load.note(touch, command.lift_height)
        elif not was_released:
            self.stood = self._load.is_on_table(touch, command.lift_height - self._place)
