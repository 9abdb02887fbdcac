"""`FlagObserver`: what a simulation says of its own numbers reaches whoever looks on, as a note."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mjtactile.recording.observer import Observer


class FlagObserver(Observer):
    """Notes `flags` (kind of doubt to reason) whenever `ask` has others; a context manager, which
    asks once more when the run has ended, however it did."""

    def __init__(self, ask: Callable[[], Mapping[str, str]], observer: Observer):
        self._ask = ask
        self._observer = observer
        self._noted: dict[str, str] = {}

    def __enter__(self) -> FlagObserver:
        return self

    def __exit__(self, *_: object) -> None:
        self.on_images()

    def on_images(self) -> None:
        """The world stands still: ask."""
        flags = dict(self._ask())
        if flags != self._noted:
            self._noted = flags
            self._observer.note(flags=flags)
