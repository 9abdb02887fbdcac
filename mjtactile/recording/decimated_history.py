"""`DecimatedHistory`: limited number of cycles, evenly spread over a run, for its report."""

from __future__ import annotations

from typing import Any

from mjtactile.recording.log_schema import Seen

_CYCLES_MAX = 32  # cycles
_ROOM = 96e6  # bytes of images


class DecimatedHistory:
    """Between half of `most` cycles and all of them, with the scene at each; fewer where images are
    large. When it is full, every second cycle is removed, and later only every second one is
    stored."""

    def __init__(self, maximum: int = _CYCLES_MAX):
        self.kept: list[tuple[Seen, Any]] = []
        """Cycles, each with its scene."""
        self._maximum = maximum - maximum % 2
        self._every = 1
        self._seen = 0

    def add(self, cycle: Seen, view: Any = None) -> None:
        """Add a cycle or skip it."""
        if not self._seen:
            size = sum(image.pixels.nbytes for image in cycle.images)
            self._maximum = max(4, min(self._maximum, 2 * int(_ROOM / 2 / max(size, 1))))
        if self._seen % self._every == 0:
            self.kept.append((cycle, view))
        if len(self.kept) > self._maximum:
            del self.kept[1::2]
            self._every *= 2
        self._seen += 1
