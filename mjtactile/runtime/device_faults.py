"""Device faults that a run survived: they may be the cause of its end, though no device failed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mjtactile.core.status import StatusCode
from mjtactile.runtime.set_down import ENDS

if TYPE_CHECKING:
    from mjtactile.runtime.cycle import Cycle

# maximum time between two cycles, s; after this time without a message, devices treat the host
# as stopped
_GAP_MAX = 0.25
_BLIND = (StatusCode.NO_IMAGE, StatusCode.PERCEPTION_TIMEOUT)


class DeviceFaults:
    """Watch for the first fault of a device before the run ends. Call `watch` once per cycle.

    `cause` describes it: "" without a fault.
    """

    def __init__(self) -> None:
        self.cause = ""
        self._before: Cycle | None = None

    def watch(self, cycle: Cycle) -> None:
        """Update with a cycle, which has not been sent in the phases "done" and "abort"."""
        before = self._before
        self._before = cycle
        if not self.cause and before is not None and before.sent.phase not in ENDS:
            self.cause = _fault(before, cycle)


def _fault(before: Cycle, now: Cycle) -> str:
    """Return the fault between two cycles, or ""."""
    gap = now.time - before.time
    if gap > _GAP_MAX:
        return f"the loop was stopped for {gap:.2f} s at {before.time:.2f} s"
    if math.isnan(now.gripper.opening):
        return f"the gripper did not answer at {now.time:.2f} s"
    for touch in now.touch:
        if touch.status.code in _BLIND:
            return f"{touch.status} at {now.time:.2f} s"
    regulates = now.sent.gauge_pressure is not None or before.sent.gauge_pressure is not None
    for was, valve in zip(before.valves, now.valves, strict=False):
        if valve.is_open and not was.is_open and not regulates:
            return f"a valve opened by itself at {now.time:.2f} s"
    return ""
