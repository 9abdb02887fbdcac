"""`Observer`: interface through which a run reports to a recorder, a progress line, or Studio."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from mjtactile.core.types import Image, Touch


class Observer:
    """Base class of run observers.

    A run calls the methods in the order of their definition. Each does nothing unless it is
    overridden. The calls come from the thread of the control loop. If a method raises an exception
    during a cycle, the gripper is first lowered and opened. The exception is then raised to the
    caller of the run.
    """

    sees: bool = True
    """True if the observer uses the views passed to `add`; without such an observer no views are
    made."""

    def start(self, session: Any) -> None:
        """Receive the session, with the rig ready and before any motion.

        Args:
            session: The `Session`.
        """

    def message(self, text: str) -> None:
        """Receive a message for the user.

        Args:
            text: One line.
        """

    def note(self, **facts: Any) -> None:
        """Receive facts of the run that belong to no cycle.

        Args:
            **facts: By name.
        """

    def add_reference(
        self, stage: str, images: Sequence[Sequence[Image]], gauge_pressure: Sequence[float | None]
    ) -> None:
        """Receive the images of a reference.

        Args:
            stage: "flat" or "rest".
            images: One list per finger.
            gauge_pressure: Gauge pressure of each chamber, Pa; None: no pressure sensor.
        """

    def on_images(self) -> None:
        """Handle the images of a cycle. A simulated world is still paused at their time."""

    def on_touches(self, time: float, touches: Sequence[Touch]) -> None:
        """Receive the estimates of a cycle, before the controller.

        Args:
            time: Time of the cycle, s.
            touches: Touch of each finger.
        """

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """Receive a cycle after its command was sent.

        Args:
            cycle: Images, estimates, requested and sent command of the cycle.
            view: The scene at that time; only in simulation, and only if an observer uses it.
            **truth: Ground truth by column (`mjtactile.recording.log_schema`); only in
            simulation.
        """


class Observers(Observer):
    """Group of observers that forwards each call to all of them in order."""

    def __init__(self, observers: Iterable[Observer]):
        self._observers = tuple(observers)
        self.sees = any(observer.sees for observer in self._observers)

    def start(self, session: Any) -> None:
        for observer in self._observers:
            observer.start(session)

    def message(self, text: str) -> None:
        for observer in self._observers:
            observer.message(text)

    def note(self, **facts: Any) -> None:
        for observer in self._observers:
            observer.note(**facts)

    def add_reference(
        self, stage: str, images: Sequence[Sequence[Image]], gauge_pressure: Sequence[float | None]
    ) -> None:
        for observer in self._observers:
            observer.add_reference(stage, images, gauge_pressure)

    def on_images(self) -> None:
        for observer in self._observers:
            observer.on_images()

    def on_touches(self, time: float, touches: Sequence[Touch]) -> None:
        for observer in self._observers:
            observer.on_touches(time, touches)

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        for observer in self._observers:
            observer.add(cycle, view, **truth)


class CycleCallback(Observer):
    """Calls a function with every cycle."""

    def __init__(self, act: Callable[[Any], Any]):
        self._act = act

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        self._act(cycle)
