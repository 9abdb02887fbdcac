"""`FlagObserver`: pass on the accuracy warnings of a simulation to the observers as notes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mjtactile.recording.observer import Observer


class FlagObserver(Observer):
    """Observer that notes `flags` whenever those of `ask` change.

    The flags map the kind of model error to its reason. It is also a context manager. At the end of
    the run it checks the flags again, also after an error.
    """

    def __init__(self, ask: Callable[[], Mapping[str, str]], observer: Observer):
        self._ask = ask
        self._observer = observer
        self._noted: dict[str, str] = {}

    def __enter__(self) -> FlagObserver:
        return self

    def __exit__(self, *_: object) -> None:
        self.on_images()

    def on_images(self) -> None:
        """Query the flags while the world is paused, and note changes."""
        flags = dict(self._ask())
        if flags != self._noted:
            self._noted = flags
            self._observer.note(flags=flags)
