"""One timed grasp of an egg in a separate process.

`python -m benchmarks.studio.probe plain|studio` prints a line of JSON. With "studio" it first
prints Studio's address, and starts when a page is open.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from typing import Any

from benchmarks.cpu_time import core_time
from mjtactile.core.scenario import Scenario
from mjtactile.recording.observer import Observer
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.grasp import run_grasp
from mjtactile.studio import panel
from mjtactile.studio.serve import watch
from mjtactile.studio.session_bridge import SessionBridge

MARK = 171  # third byte of an image whose first two bytes are the cycle number
# times of a cycle, s: simulated, wall, and core time with child processes
Moments = tuple[float, float, float]
_FRAMES = 60  # rendered before the start: by then the page has its model and textures


class Watched(SessionBridge):
    """A session bridge that measures its own time."""

    def __init__(self) -> None:
        super().__init__()
        self.fastest = math.inf
        self.cycles: list[Moments] = []
        # time, s, when each cycle's images were ready, on the clock shared with the page
        self.taken: list[float] = []
        self.spent: list[float] = []  # time of the session's thread in each cycle, s
        self.frame_requests = 0

    def on_images(self) -> None:
        start = time.perf_counter()
        super().on_images()
        self.taken.append(time.time())
        self.spent.append(time.perf_counter() - start)

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        start = time.perf_counter()
        super().add(cycle, view, **truth)
        now = time.perf_counter()
        self.cycles.append((cycle.time, now, core_time()))
        self.spent[-1] += now - start

    def snapshot(self) -> Any:
        if threading.current_thread().name != "studio":
            self.frame_requests += 1
        return super().snapshot()


def studio() -> dict[str, Any]:
    """Run with Studio.

    Return its speed, its fraction of the session's thread, and the times when each cycle's images
    were ready.
    """
    bridge = Watched()
    upload = panel.Panel._upload

    def marked(self: Any, k: int, view: str, rgb: Any) -> None:
        if (k, view) == (0, "image"):
            high, low = divmod(self._captured[0].number, 256)
            rgb[0, 0] = low, high, MARK
        upload(self, k, view, rgb)

    panel.Panel._upload = marked
    bridge.step()
    threading.Thread(target=_start, args=(bridge,), daemon=True).start()
    watch(bridge, browser=False, runs=1)
    return {
        **_speed(bridge.cycles),
        "spent_ms": 1e3 * sorted(bridge.spent[2:])[len(bridge.spent) // 2],
        "taken": bridge.taken,
    }


def _start(bridge: Watched) -> None:
    """Start the run when the page is open."""
    while bridge.frame_requests < 3 * _FRAMES:  # three windows query in each frame
        time.sleep(0.05)
    bridge.paused = False


class Plain(Observer):
    """Observer that stores only the time."""

    def __init__(self) -> None:
        self.cycles: list[Moments] = []

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        self.cycles.append((cycle.time, time.perf_counter(), core_time()))


def plain() -> dict[str, Any]:
    """Run without Studio."""
    recorder = Plain()
    run_grasp(Scenario(controller="gentle"), [recorder])
    return _speed(recorder.cycles)


def _speed(cycles: list[Moments]) -> dict[str, float]:
    """Return simulated over wall time, and core time per simulated second, s.

    Counting starts at the third cycle, since with Studio the first waits for the page.
    """
    simulated, wall, core = (end - start for start, end in zip(cycles[2], cycles[-1], strict=True))
    return {"factor": simulated / wall, "core_s": core / simulated}


if __name__ == "__main__":
    sys.stdout.write(json.dumps({"plain": plain, "studio": studio}[sys.argv[1]]()) + "\n")
