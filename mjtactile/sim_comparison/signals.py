"""Signals of a real or simulated rig over time: forces, markers and pressures.

All come from the same sensing pipeline.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array, Touch, ValveState
from mjtactile.export.episode import RecordedEpisode

KINDS = ("force", "markers", "pressure")
TOLERANCE = {"force": 0.03, "markers": 3e-5, "pressure": 25.0}
"""Rms tolerances, N, m, Pa, for a simulator and a rig that matches its file.

The force tolerance is the specified accuracy of an estimated force. The pipeline measures each
marker within 20 um, and repeated runs do not agree better. Pressure sensors of an emulated rig,
read through a board a little later, differed by 17 Pa.
"""
UNIT = {"force": (1e3, "mN"), "markers": (1e6, "um"), "pressure": (1.0, "Pa")}


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals at `time` (t,) s from the first cycle on, for each finger f.

    `force` (t, f, 3) N acts on the membrane in S. `markers` (t, f, n, 3) m are in S. `pressure` (t,
    f) Pa is the gauge pressure. NaN: unknown.
    """

    time: Array
    force: Array
    markers: Array
    pressure: Array

    @property
    def fingers(self) -> int:
        return self.force.shape[1]

    def at(self, time: Array) -> Signals:
        """Return the signals nearest in time to each of (k,) s."""
        after = np.clip(np.searchsorted(self.time, time), 1, len(self.time) - 1)
        nearer = time - self.time[after - 1] < self.time[after] - time
        index = after - nearer
        return Signals(time, self.force[index], self.markers[index], self.pressure[index])

    def of(self, kind: str) -> Array:
        """Return the signals of one kind, (t, f, ...)."""
        return getattr(self, kind)


class CollectedSignals:
    """Signals that are being gathered, for `counts` markers of each finger."""

    def __init__(self, counts: Sequence[int]):
        self._counts = tuple(counts)
        self._rows: list[tuple[float, Array, Array, Array]] = []

    def add(self, time: float, touches: Sequence[Touch], pressures: Sequence[float | None]) -> None:
        """Append one cycle."""
        force = np.full((len(self._counts), 3), np.nan)
        markers = np.full((len(self._counts), max(self._counts), 3), np.nan)
        for k, touch in enumerate(touches):
            if touch.traction is not None and touch.status.code == "ok":
                force[k] = touch.traction.wrench[:3]
            if touch.markers is not None:
                markers[k, touch.markers.ids] = touch.markers.p_SM
        gauge = [math.nan if value is None else float(value) for value in pressures]
        gauge += [math.nan] * (len(self._counts) - len(gauge))
        self._rows.append((time, force, markers, np.array(gauge)))

    def signals(self) -> Signals:
        """Return all signals. The time, s, starts at zero."""
        time, force, markers, pressure = (np.array(part) for part in zip(*self._rows, strict=True))
        return Signals(time - time[0], force, markers, pressure)


def gauges(valves: Sequence[ValveState], episode: Any = None) -> list[float | None]:
    """Return the reading of each valve's pressure sensor, Pa, corrected for its measured zero."""
    shown = [valve.gauge_pressure for valve in valves]
    if episode is None:
        return shown
    calibrations = [episode.calibrations[name] for name in episode.fingers]
    return [
        value if value is None or calibration is None else calibration.pressure(value)
        for value, calibration in zip(shown, calibrations, strict=False)
    ]


def recorded(episode: RecordedEpisode) -> Signals:
    """Return a recording's signals, estimated again from its images if available."""
    counts = [episode.design_of(name).markers.count for name in episode.fingers]
    gathered = CollectedSignals(counts)
    rows = []
    for cycle, observed in enumerate(episode.cycles()):
        pressures = gauges(episode.recording.valves(cycle), episode)
        gathered.add(observed.time, observed.touch, pressures)
        rows.append(np.asarray(observed.row["wrench"], float).reshape(len(counts), -1)[:, :3])
    found = gathered.signals()
    if episode.re_estimate:
        return found
    return Signals(found.time, np.array(rows), found.markers, found.pressure)


def differences(recorded: Signals, simulated: Signals) -> dict[str, Array]:
    """Return the RMS difference (f,) of each kind, SI; NaN where one of the two is unknown."""
    found = {}
    for kind in KINDS:
        difference = recorded.of(kind) - simulated.of(kind)
        squares = (difference**2).reshape(len(difference), recorded.fingers, -1)
        known = np.isfinite(squares)
        count = known.sum(axis=(0, 2))
        total = np.where(known, squares, 0.0).sum(axis=(0, 2))
        mean = np.full(recorded.fingers, np.nan)
        np.divide(total, count, out=mean, where=count > 0)
        found[kind] = np.sqrt(mean)
    return found
