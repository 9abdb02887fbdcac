"""`Show`: what a session shows and what is asked of it. The session's thread writes, the viewer's reads, neither waits.

It takes the place of a recorder and of a progress. What is asked of the world (a valve, a pull) is done by the session's own
thread between two cycles, as a command of a controller would be.
"""

from __future__ import annotations

import math
import queue
import threading
import time as wall
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.errors import SimulationError
from mjtactile.core.types import Array, Image
from mjtactile.run.loop import Cycle
from mjtactile.run.session import Session

HISTORY = 20.0  # s that the plots show
_PAUSED = 0.02  # s between two looks at whether it still is


class Restart(SimulationError):
    """Somebody asked for another run: the world that was is given up as it is."""

    def __init__(self) -> None:
        super().__init__("another run was asked for", step=0, time=0.0)


@dataclass(frozen=True, eq=False)
class Shown:
    """One cycle: what was felt, the scene then, and by truth, where there is one, the normal forces (n,) N."""

    number: int
    cycle: Cycle
    view: Any
    true: Array


@dataclass(frozen=True)
class Row:
    """One cycle in the plots: `time` s, forces (n,) N felt, their sd, and true, gauge pressures (n,) Pa, `opening` m."""

    time: float
    felt: tuple[float, ...]
    sd: tuple[float, ...]
    true: tuple[float, ...]
    pressure: tuple[float, ...]
    opening: float
    phase: str


class Show:
    """Give it to `run_grasp` as recorder, progress and `on_open`."""

    patience = math.inf

    def __init__(self, say: Callable[[str], None] = lambda _: None):
        self.session: Session | None = None
        self.latest: Shown | None = None
        self.rows: deque[Row] = deque(maxlen=2000)
        self.message, self.outcome = "", ""
        self.runs = 0
        self.paused = False
        self.fastest = 1.0
        """Times as fast as the clock, at most (inf: as fast as it goes)."""
        self.restart = threading.Event()
        self.closed = threading.Event()
        self._single = False
        self._say = say
        self._tasks: queue.SimpleQueue[Callable[[Session], None]] = queue.SimpleQueue()
        self._pace: tuple[float, float] | None = None

    # what the session's thread calls

    def open(self, session: Session) -> None:
        """A session begins."""
        self.session, self.latest, self.outcome, self._pace = session, None, "", None
        self.rows.clear()
        self.runs += 1

    def note(self, **values: Any) -> None: ...

    def add_reference(self, stage: str, images: list[list[Image]], pressure_gauge: list[float | None]) -> None:
        self._leave()

    def message_(self, text: str) -> None:
        self.message = text
        self._say(text)

    def update(self, phase: str, time: float, force: float) -> None: ...

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        """Show a cycle, do what was asked for, keep to the clock, wait while paused. Raises Restart when that was asked for."""
        true = np.array(truth.get("force_normal_true", [math.nan] * len(cycle.touch)), dtype=float)
        self.latest = Shown(0 if self.latest is None else self.latest.number + 1, cycle, view, true)
        self.rows.append(_row(cycle, true))
        while self.rows[-1].time - self.rows[0].time > HISTORY:
            self.rows.popleft()
        self._work()
        while self.paused and not self._single:
            self._leave()
            wall.sleep(_PAUSED)
            self._work()
            self._pace = None
        self._single = False
        self._leave()
        self._wait(cycle.time)

    # what the viewer's thread calls

    def ask(self, task: Callable[[Session], None]) -> None:
        """Have the session's thread do `task` after its next cycle."""
        self._tasks.put(task)

    def step(self) -> None:
        """One cycle more, and pause."""
        self.paused, self._single = True, True

    def _work(self) -> None:
        if (session := self.session) is None:
            return
        for _ in range(self._tasks.qsize()):
            task = self._tasks.get()
            try:
                task(session)
            except Exception as error:  # noqa: BLE001  # the run goes on; the panel says it
                self.message_(f"{type(error).__name__}: {error}")

    def _leave(self) -> None:
        if self.restart.is_set() or self.closed.is_set():
            raise Restart

    def _wait(self, time: float) -> None:
        """Until the clock has come as far as the rig's, where that is simulated and ahead."""
        if self.session is None or self.session.rig.scene is None or not math.isfinite(self.fastest):
            return
        now = wall.monotonic()
        if self._pace is None or (time - self._pace[1]) / self.fastest < now - self._pace[0]:
            self._pace = (now, time)
        wall.sleep(max(0.0, self._pace[0] + (time - self._pace[1]) / self.fastest - now))


class Voice:
    """The show's side of a progress."""

    def __init__(self, show: Show):
        self.message, self.update = show.message_, show.update


def _row(cycle: Cycle, true: Array) -> Row:
    pressures = tuple(math.nan if valve.pressure_gauge is None else valve.pressure_gauge for valve in cycle.valves)
    return Row(cycle.time, tuple(t.force_normal for t in cycle.touch), tuple(t.force_normal_sd for t in cycle.touch),
               tuple(true.tolist()), pressures, cycle.gripper.opening, cycle.sent.phase)
