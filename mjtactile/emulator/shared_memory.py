"""Memory page shared by the emulator's two processes: commands to the world, and its state.

A servo must reply within a millisecond, and a physics step holds Python's interpreter for longer.
Each value is the newest, a double that one writer writes atomically.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Sequence

import numpy as np

FROM_WORLD = (
    *("time", "lost", "opening", "speed", "grip_force", "lift_height", "object_height"),
    *("pressure_1", "pressure_2", "contact_1", "contact_2"),
    *("image_delay", "failed", "images"),
)
FAULTS_TO_WORLD = (
    *("puncture", "frames_frozen", "frames_dark", "frames_saturated"),
    *("frames_stopped", "frames_late", "frames_duplicated"),
)
TO_WORLD = (
    *("goal", "force", "lift_goal", "open_1", "supply_1", "open_2", "supply_2"),
    *FAULTS_TO_WORLD,
)


class SharedState:
    """Named values in a file descriptor (`system.memory_file`), by `state["opening"]`."""

    def __init__(self, descriptor: int, names: Sequence[str] = (*FROM_WORLD, *TO_WORLD)):
        os.ftruncate(descriptor, mmap.PAGESIZE)
        self._memory = mmap.mmap(descriptor, mmap.PAGESIZE)
        self._values = np.frombuffer(self._memory, dtype=np.float64, count=len(names))
        self._offsets = {name: i for i, name in enumerate(names)}

    def __getitem__(self, name: str) -> float:
        return float(self._values[self._offsets[name]])

    def __setitem__(self, name: str, value: float) -> None:
        self._values[self._offsets[name]] = value

    def close(self) -> None:
        del self._values
        self._memory.close()
