"""`Observer`: what a run tells to whoever looks on: a recorder, a progress line, Studio."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from mjtactile.core.types import Image


class Observer:
    """Its methods are called by a run, in the order in which they stand here; each does nothing
    unless it is overridden.

    They are called from the thread of the control loop. Whatever one of them raises in a cycle
    makes the hand go down and open before it is raised to who started the run.
    """

    sees: bool = True
    """Whether it looks at the views that `add` is given: where nobody does, none is made."""

    def begin(self, session: Any) -> None:
        """The rig is there, and nothing has moved yet.

        Args:
            session: The `Session`.
        """

    def message(self, text: str) -> None:
        """The run has something to say to a person.

        Args:
            text: One line.
        """

    def note(self, **facts: Any) -> None:
        """There are facts of the run that are no cycle.

        Args:
            **facts: By name.
        """

    def add_reference(
        self, stage: str, images: Sequence[Sequence[Image]], gauge_pressure: Sequence[float | None]
    ) -> None:
        """A reference was taken.

        Args:
            stage: "flat" or "rest".
            images: One list a finger.
            gauge_pressure: Pa that it was taken at, for each valve; None: it has no sensor.
        """

    def on_images(self) -> None:
        """A cycle's images were taken, and a simulated world still stands at that time."""

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """A cycle's command was sent.

        Args:
            cycle: What was seen, felt, asked for and sent.
            view: The scene at that time; of a simulation alone, and where somebody looks at it.
            **truth: Ground truth by column (`mjtactile.recording.log_schema`); of a simulation
                alone.
        """


class Observers(Observer):
    """Several as one: each is told in turn."""

    def __init__(self, observers: Iterable[Observer]):
        self._observers = tuple(observers)
        self.sees = any(observer.sees for observer in self._observers)

    def begin(self, session: Any) -> None:
        for observer in self._observers:
            observer.begin(session)

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

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        for observer in self._observers:
            observer.add(cycle, view, **truth)


class CycleCallback(Observer):
    """Calls a function with every cycle."""

    def __init__(self, act: Callable[[Any], Any]):
        self._act = act

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        self._act(cycle)
