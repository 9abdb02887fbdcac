"""`UnsensedForceMonitor`: flag for servo force that exceeds the force measured by the fingers.

A membrane cannot sense loads on its frame, on a finger's side, or between the jaws. The servo
currents show such loads roughly. Data sheet torques are accurate to 20 %. Gear friction is learned
while there is no contact.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from mjtactile.core.flags import Cadence, Flag, FlagTracker
from mjtactile.core.types import Array
from mjtactile.recording.observer import Observer

KIND = "unsensed_force"
_LASTS = 0.3  # window, s: images are older than currents, and stopped jaws push for a moment
_FREE = 1.5  # factor on the no-load effort: gear friction grows with load
_EXCESS_MIN = 0.5  # excess that is always allowed, N
_SHARE = 0.3  # allowed fraction of the servo force: data sheet torque, current resolution


class UnsensedForceMonitor(Observer):
    """Comparison of the servo effort with the measured contact forces in each cycle.

    Args:
        names: Names of the fingers.
        period: Cycle period, s.
    """

    def __init__(self, names: tuple[str, ...], period: float):
        self._names = names
        count = math.ceil(_LASTS / period)
        self._efforts: deque[float] = deque(maxlen=count)
        self._estimated: deque[float] = deque(maxlen=count)
        self._free = 0.0
        self._maximum = 0.0
        self._text = ""
        self._tracker: FlagTracker | None = None

    @property
    def flags(self) -> dict[str, Flag]:
        """The flag by its kind; empty if it was never raised."""
        return {} if self._tracker is None else self._tracker.flags()

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """Add one cycle. A cycle with unknown values is ignored and clears the window of earlier
        cycles."""
        if self._tracker is None:
            self._tracker = FlagTracker(cycle.time)
        estimated = float(np.mean([touch.force_normal for touch in cycle.touch]))
        effort = float(cycle.gripper.effort)
        if not math.isfinite(estimated + effort):
            self._efforts.clear()
            self._estimated.clear()
            return
        self._efforts.append(effort)
        self._estimated.append(estimated)
        if len(self._efforts) < (self._efforts.maxlen or 0):
            return
        if not any(touch.touching for touch in cycle.touch):
            # effort above `_EXCESS_MIN` is not friction but a load that no finger senses
            self._free = max(self._free, min(abs(float(np.mean(self._efforts))), _EXCESS_MIN))
        is_up = self._exceeds(np.array(self._efforts), np.array(self._estimated))
        self._tracker.update(cycle.time, {KIND: self._text} if is_up else {}, {Cadence.CYCLE})

    def _exceeds(self, effort: Array, estimated: Array) -> bool:
        """Return True if the minimum excess force over the window is too large, and set the flag
        text if it is also the largest so far."""
        beyond = effort - estimated
        minimum = int(beyond.argmin())
        allowed = _EXCESS_MIN + _FREE * self._free + _SHARE * abs(float(effort[minimum]))
        if beyond[minimum] <= allowed:
            return False
        if beyond[minimum] <= self._maximum:
            return True
        self._maximum = float(beyond[minimum])
        names = " and ".join(self._names)
        self._text = (
            f"the servos push with {effort[minimum]:.1f} N, but {names} measure "
            f"{estimated[minimum]:.1f} N on average: frames, finger sides or the jaws carry "
            f"{self._maximum:.1f} N, more than the allowed {allowed:.1f} N"
        )
        return True
