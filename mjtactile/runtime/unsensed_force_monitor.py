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

from mjtactile.core.types import Array
from mjtactile.runtime.flag_monitor import FlagMonitor

KIND = "unsensed_force"
_LASTS = 0.3  # window, s: images are older than currents, and stopped jaws push for a moment
_FREE = 1.5  # factor on the no-load effort: gear friction grows with load
_EXCESS_MIN = 0.5  # excess that is always allowed, N
_SHARE = 0.3  # allowed fraction of the servo force: data sheet torque, current resolution


class UnsensedForceMonitor(FlagMonitor):
    """Comparison of the servo effort with the measured contact forces in each cycle.

    Args:
        names: Names of the fingers.
        period: Cycle period, s.
    """

    def __init__(self, names: tuple[str, ...], period: float):
        super().__init__(KIND)
        self._names = names
        count = math.ceil(_LASTS / period)
        self._efforts: deque[float] = deque(maxlen=count)
        self._estimated: deque[float] = deque(maxlen=count)
        self._free = 0.0

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """Add one cycle. A cycle with unknown values is ignored and clears the window of earlier
        cycles."""
        self._start(cycle.time)
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
        self._update(cycle.time, self._excess(np.array(self._efforts), np.array(self._estimated)))

    def _excess(self, effort: Array, estimated: Array) -> list[tuple[float, str]]:
        """Return the minimum excess force over the window and its reason if it is too large."""
        beyond = effort - estimated
        minimum = int(beyond.argmin())
        allowed = _EXCESS_MIN + _FREE * self._free + _SHARE * abs(float(effort[minimum]))
        excess = float(beyond[minimum])
        if excess <= allowed:
            return []
        names = " and ".join(self._names)
        text = (
            f"the servos push with {effort[minimum]:.1f} N, but {names} measure "
            f"{estimated[minimum]:.1f} N on average: frames, finger sides or the jaws carry "
            f"{excess:.1f} N, more than the allowed {allowed:.1f} N"
        )
        return [(excess, text)]
