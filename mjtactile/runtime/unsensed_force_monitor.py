"""`UnsensedForceMonitor`: what a rig's servos push beyond what its fingers feel, as a flag.

A membrane has no word of what leans on its frame, on a finger's side, or between the jaws. The
servos' currents have, roughly: a data sheet's torque is good to 20 %, and gears take what moving
them takes, which is learnt while nothing touches.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from mjtactile.core.types import Array
from mjtactile.recording.observer import Observer

KIND = "beyond"
_LASTS = 0.3  # s: an image is older than a current, and jaws that are stopped push for a moment
_FREE = 1.5  # times what moving took with nothing touching: gears take more under load
_LEAST = 0.5  # N that are never judged
_SHARE = 0.3  # of what the servos push: torque of a data sheet, currents' resolution


class UnsensedForceMonitor(Observer):
    """Compares effort with felt forces, cycle by cycle.

    Args:
        names: The fingers'.
        period: Of a cycle, s.
    """

    def __init__(self, names: tuple[str, ...], period: float):
        self._names = names
        count = math.ceil(_LASTS / period)
        self._efforts: deque[float] = deque(maxlen=count)
        self._felt: deque[float] = deque(maxlen=count)
        self._free = 0.0
        self._most = 0.0
        self._text = ""

    @property
    def flags(self) -> Mapping[str, str]:
        """The kind of doubt and its reason, where there has been one."""
        return {KIND: self._text} if self._text else {}

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """Note one cycle; one in which anything is unknown tells nothing, and what was before it
        counts no more."""
        felt = float(np.mean([touch.force_normal for touch in cycle.touch]))
        effort = float(cycle.gripper.effort)
        if not math.isfinite(felt + effort):
            self._efforts.clear()
            self._felt.clear()
            return
        self._efforts.append(effort)
        self._felt.append(felt)
        if len(self._efforts) < (self._efforts.maxlen or 0):
            return
        if not any(touch.touching for touch in cycle.touch):
            # more than the least is no friction, but something that no finger feels
            self._free = max(self._free, min(abs(float(np.mean(self._efforts))), _LEAST))
        self._judge(np.array(self._efforts), np.array(self._felt))

    def _judge(self, effort: Array, felt: Array) -> None:
        """What is pushed at least, over all these cycles."""
        beyond = effort - felt
        least = int(beyond.argmin())
        allowed = _LEAST + _FREE * self._free + _SHARE * abs(float(effort[least]))
        if beyond[least] <= max(allowed, self._most):
            return
        self._most = float(beyond[least])
        names = " and ".join(self._names)
        self._text = (
            f"the servos push with {effort[least]:.1f} N and {names} feel {felt[least]:.1f} N in "
            f"the mean: frames, fingers' sides or the jaws themselves carry {self._most:.1f} N, "
            f"give or take {allowed:.1f}"
        )
