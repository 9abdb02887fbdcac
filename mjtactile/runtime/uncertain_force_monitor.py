"""`UncertainForceMonitor`: flag for an estimated force whose 95 % interval is wider than +- 50 %.

Light touches have wide intervals, too, and are not counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mjtactile.core.types import Touch
from mjtactile.runtime.flag_monitor import FlagMonitor

KIND = "uncertain"
_SD_FRACTION = 0.25  # sd of the force at which its 95 % interval is +- 50 %
_WELL_ABOVE = 5.0  # ratio of the force to the least detectable one: a light touch has less
_DETECTABLE_MIN = 0.02  # least detectable force, N, before the sensor was ever untouched
LASTS = 0.2
"""Minimum duration, s: the first images of a tap have wide intervals."""


class UncertainForceMonitor(FlagMonitor):
    """Comparison of each finger's force with its standard deviation in each image.

    Args:
        names: Names of the fingers.
        lasts: Minimum duration, s; 0 for settled loads.
    """

    def __init__(self, names: Sequence[str], lasts: float = LASTS):
        super().__init__(KIND)
        self._names = names
        self._lasts = lasts
        self._detectable = [math.inf] * len(names)
        self._since = [math.nan] * len(names)

    def on_touches(self, time: float, touches: Sequence[Touch]) -> None:
        """Add the touches at `time`, s. The interval of an unknown force is unknown."""
        found = [self._violation(i, time, touch) for i, touch in enumerate(touches)]
        self._update(time, [entry for entry in found if entry is not None])

    def _violation(self, i: int, time: float, touch: Touch) -> tuple[float, str] | None:
        """Return standard deviation and reason if finger `i` has had a wide interval for long
        enough. An untouched sensor reports at least its least detectable force."""
        force, sd = float(touch.force_normal), float(touch.force_normal_sd)
        if not touch.touching and math.isfinite(sd):
            self._detectable[i] = min(self._detectable[i], sd)
        known = self._detectable[i]
        detectable = known if math.isfinite(known) else _DETECTABLE_MIN
        is_light = not touch.touching or not force > _WELL_ABOVE * max(detectable, _DETECTABLE_MIN)
        if is_light or not sd > _SD_FRACTION * force:
            self._since[i] = math.nan
            return None
        if math.isnan(self._since[i]):
            self._since[i] = time
        if time - self._since[i] < self._lasts:
            return None
        return sd, (
            f"{self._names[i]} measures {force:.2g} N with a standard deviation of {sd:.2g} N, "
            f"{100 * sd / force:.0f} %"
        )
