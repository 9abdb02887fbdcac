"""`FlagMonitor`: base of the monitors that raise one kind of flag from estimates and devices."""

from __future__ import annotations

from collections.abc import Iterable

from mjtactile.core.flags import Cadence, Flag, FlagTracker
from mjtactile.recording.observer import Observer


class FlagMonitor(Observer):
    """Observer with the flag of one kind. It informs the user only.

    Args:
        kind: Kind of the flag.
    """

    def __init__(self, kind: str):
        self._kind = kind
        self._maximum = 0.0
        self._text = ""
        self._tracker: FlagTracker | None = None

    @property
    def flags(self) -> dict[str, Flag]:
        """The flag by its kind; empty if it was never raised."""
        return {} if self._tracker is None else self._tracker.flags()

    def _start(self, time: float) -> FlagTracker:
        """Return the tracker. Its first check starts at `time`, s."""
        if self._tracker is None:
            self._tracker = FlagTracker(time)
        return self._tracker

    def _update(self, time: float, found: Iterable[tuple[float, str]]) -> None:
        """Add a check at `time`, s: amount and reason of each violation. The reason of the largest
        amount so far is kept."""
        found = list(found)
        for amount, text in found:
            if amount > self._maximum:
                self._maximum = amount
                self._text = text
        reasons = {self._kind: self._text} if found else {}
        self._start(time).update(time, reasons, {Cadence.CYCLE})
