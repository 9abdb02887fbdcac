"""`FlagObserver`: pass on the accuracy warnings of a simulation to the observers as notes."""

from __future__ import annotations

from collections.abc import Callable

from mjtactile.core.flags import Flags
from mjtactile.recording.observer import Observer


class FlagObserver(Observer):
    """Observer that notes `flags` whenever kinds or reasons of those of `ask` change.

    It is also a context manager. At the end of the run, also after an error, it notes them with
    their final times.
    """

    def __init__(self, ask: Callable[[], Flags], observer: Observer):
        self._ask = ask
        self._observer = observer
        self._noted: Flags = {}

    def __enter__(self) -> FlagObserver:
        return self

    def __exit__(self, *_: object) -> None:
        if flags := self._ask():
            self._observer.note(flags=flags)

    def on_images(self) -> None:
        """Query the flags while the world is paused, and note changes."""
        flags = self._ask()
        if flags != self._noted:
            self._noted = flags
            self._observer.note(flags=flags)
