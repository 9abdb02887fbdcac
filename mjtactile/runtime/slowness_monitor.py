"""`SlownessMonitor`: report why a simulation is slow, from the measured time of its parts."""

from __future__ import annotations

import time as wall
from collections.abc import Callable
from typing import Any

from mjtactile.recording.observer import Observer
from mjtactile.rig.workload import Workload

SLOW = 0.3  # of real time
_WINDOW = 4.0  # wall time of a measurement, s
_CAUSE_FRACTION = 0.5  # fraction of the time of a part that is a cause
_MANY = 4  # geoms near the membranes that count as many


class SlownessMonitor(Observer):
    """Observer that sends one message per cause while the run is below `SLOW` of real time.

    Args:
        ask: Function that returns the workload of the rig so far.
        notify: Callback for messages, one line each.
        now: Wall clock, s.
        contact_shapes: True if the shape of every touch is estimated.
    """

    def __init__(
        self,
        ask: Callable[[], Workload],
        notify: Callable[[str], None],
        now: Callable[[], float] = wall.perf_counter,
        *,
        contact_shapes: bool = False,
    ):
        self._ask = ask
        self._notify = notify
        self._now = now
        self._shapes = contact_shapes
        self._start: tuple[float, float, Workload] | None = None
        self._perception = self._controller = 0.0
        self._load = self._largest = ask()  # of these images; with most contacts in the window
        self._named: set[str] = set()
        self._is_warm = False

    def on_images(self) -> None:
        """Query the workload while the world is paused."""
        self._load = self._ask()

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """Add the times of a cycle. Send a message at the end of a slow window."""
        load = self._load
        now = self._now()
        if self._start is None:
            self._start = now, cycle.time, load
            self._perception = self._controller = 0.0
            self._largest = load
            return
        self._perception += 1e-3 * cycle.perception_ms
        self._controller += 1e-3 * cycle.controller_ms
        if (load.contacts, load.geoms) > (self._largest.contacts, self._largest.geoms):
            self._largest = load
        before, time, first = self._start
        if now - before < _WINDOW:
            return
        self._start = None
        if not self._is_warm:  # the first cycles load and prepare code
            self._is_warm = True
            return
        factor = (cycle.time - time) / (now - before)
        if factor >= SLOW:
            return
        fractions = self._fractions(load, first, now - before)
        largest = max(fractions, key=lambda name: fractions[name])
        # parts that run in parallel may each take most of the time
        causes = [
            name for name in fractions if fractions[name] > _CAUSE_FRACTION or name == largest
        ]
        if self._named.issuperset(causes):
            return
        self._named.update(causes)
        texts = [
            f"{name} takes {100 * fractions[name]:.0f} % of the time "
            f"({_cause(name, self._largest, self._shapes)})"
            for name in sorted(causes, key=lambda name: -fractions[name])
        ]
        self._notify(f"slow: {factor:.2g} x real time; {', '.join(texts)}")

    def _fractions(self, load: Workload, first: Workload, elapsed: float) -> dict[str, float]:
        """Return the fraction of the time that each part took."""
        seconds = {
            "physics": load.physics - first.physics,
            "rendering": load.rendering - first.rendering,
            "perception": self._perception,
            "controller": self._controller,
        }
        return {name: min(1.0, spent / elapsed) for name, spent in seconds.items()}


def _cause(part: str, load: Workload, contact_shapes: bool) -> str:
    """Return the cause of a slow part, and a faster alternative."""
    if part == "rendering":
        return "camera images; quicker: --effects=-images"
    if part == "controller":
        return "the controller file; quicker: less work in its step"
    if part == "perception":
        if contact_shapes:
            return "contact shapes; quicker: without --contact-shapes, or --workers 2"
        return "markers and forces; quicker: --effects=-mesh,-pipeline, or --workers 2"
    if load.elements:
        return f"a soft object of {load.elements} elements; quicker: fewer elements"
    text = f"{load.geoms} geoms near the membranes, {load.contacts} contact points"
    if load.vertices:
        text = f"{text}, {load.vertices} vertices"
    remedies = ["a larger time step"]
    if load.vertices:
        remedies = ["--effects=-mesh"]
    if load.geoms >= _MANY:
        remedies = ["one primitive or mesh in place of these geoms", *remedies]
    return f"{text}; quicker: {', or '.join(remedies)}"
