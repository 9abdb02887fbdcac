"""`UncertainForceMonitor`: flag for an estimated force whose 95 % interval is wider than +- 50 %.

Light touches have wide intervals, too, and are not counted. The flag informs the user only.
"""

from __future__ import annotations

import math
from typing import Any

from mjtactile.core.flags import Cadence, Flag, FlagTracker
from mjtactile.recording.observer import Observer

KIND = "uncertain"
_SD_FRACTION = 0.25  # sd of the force at which its 95 % interval is +- 50 %
_WELL_ABOVE = 5.0  # ratio of the force to the least detectable one: a light touch has less
_DETECTABLE_MIN = 0.02  # least detectable force, N, before the sensor was ever untouched
_LASTS = 0.2  # minimum duration, s: the first images of a tap have wide intervals


class UncertainForceMonitor(Observer):
    """Comparison of each finger's force with its standard deviation in each cycle.

    Args:
        names: Names of the fingers.
    """

    def __init__(self, names: tuple[str, ...]):
        self._names = names
        self._detectable = [math.inf] * len(names)
        self._since = [math.nan] * len(names)
        self._maximum = 0.0
        self._text = ""
        self._tracker: FlagTracker | None = None

    @property
    def flags(self) -> dict[str, Flag]:
        """The flag by its kind; empty if it was never raised."""
        return {} if self._tracker is None else self._tracker.flags()

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """Add one cycle. The interval of an unknown force is unknown."""
        if self._tracker is None:
            self._tracker = FlagTracker(cycle.time)
        up = [self._exceeds(i, cycle.time, touch) for i, touch in enumerate(cycle.touch)]
        self._tracker.update(cycle.time, {KIND: self._text} if any(up) else {}, {Cadence.CYCLE})

    def _exceeds(self, i: int, time: float, touch: Any) -> bool:
        """Return True if finger `i` has had a wide interval for `_LASTS`. Set the flag text if its
        standard deviation is the largest so far. An untouched sensor reports at least its least
        detectable force."""
        force, sd = float(touch.force_normal), float(touch.force_normal_sd)
        if not touch.touching and math.isfinite(sd):
            self._detectable[i] = min(self._detectable[i], sd)
        known = self._detectable[i]
        detectable = known if math.isfinite(known) else _DETECTABLE_MIN
        is_light = not touch.touching or not force > _WELL_ABOVE * max(detectable, _DETECTABLE_MIN)
        wide = not is_light and sd > _SD_FRACTION * force
        if not wide:
            self._since[i] = math.nan
            return False
        if math.isnan(self._since[i]):
            self._since[i] = time
        if time - self._since[i] < _LASTS:
            return False
        if sd > self._maximum:
            self._maximum = sd
            self._text = (
                f"{self._names[i]} measures {force:.2g} N with a standard deviation of {sd:.2g} N, "
                f"{100 * sd / force:.0f} %"
            )
        return True
