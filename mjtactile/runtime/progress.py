"""Progress of a run on stderr: phase, time, force and real-time factor.

On a terminal, one line is rewritten. Elsewhere (a log file, CI), one line per phase is printed.
Nothing is written to stdout.
"""

from __future__ import annotations

import math
import sys
import time as wall
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from mjtactile.core.types import PHASES
from mjtactile.recording.observer import Observer

if TYPE_CHECKING:
    from mjtactile.runtime.cycle import Cycle

_BAR = 18
_REFRESH = 0.1  # minimum wall time between updates of the line, s
_STEPS = PHASES[: PHASES.index("done")]  # the phases of a grasp in order: the bar counts them


class Progress(Observer):
    """Progress display, as an observer of a run or on its own.

    On its own, call `update` in each cycle. Call `message` for messages before and after the run.
    Call `close` to end the line.
    """

    def __init__(self, stream: TextIO | None = None, *, quiet: bool = False):
        self._stream = sys.stderr if stream is None else stream
        self._quiet = quiet
        self._live = not quiet and self._stream.isatty()
        self._phase = ""
        self._line_open = False
        self._start_wall = self._start_time = self._updated = -math.inf

    def message(self, text: str) -> None:
        """Print one line."""
        if not self._quiet:
            self.close()
            print(text, file=self._stream, flush=True)

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        """Show a cycle with the mean estimated force of its fingers."""
        force = float(np.mean([touch.force_normal for touch in cycle.touch]))
        self.update(cycle.sent.phase, cycle.time, force)

    def update(self, phase: str, time: float, force: float) -> None:
        """Update the display.

        `time`, s, is on the rig's clock and shown relative to the first call. `force`, N, is the
        mean estimated normal force per finger (NaN: unknown).
        """
        now = wall.perf_counter()
        if self._start_wall == -math.inf:
            self._start_wall = now
            self._start_time = time
        changed = phase != self._phase
        self._phase = phase
        if self._quiet or not (changed or (self._live and now - self._updated > _REFRESH)):
            return
        text = self._text(phase, time, force, now)
        if self._live:
            self._stream.write(f"\r\x1b[2K{self._bar(phase)} {text}")
            self._stream.flush()
            self._line_open = True
            self._updated = now
        else:
            print(text, file=self._stream, flush=True)

    def _text(self, phase: str, time: float, force: float, now: float) -> str:
        shown = f"{force:5.2f} N" if math.isfinite(force) else "unknown"
        spent = now - self._start_wall
        factor = f"{(time - self._start_time) / spent:.2f}x real time" if spent > 0.5 else ""
        return (
            f"{phase:<9} t = {time - self._start_time:6.2f} s   force {shown}   {factor}".rstrip()
        )

    def _bar(self, phase: str) -> str:
        done = (_STEPS.index(phase) + 1) / len(_STEPS) if phase in _STEPS else 1.0
        full = round(done * _BAR)
        return "[" + "#" * full + "-" * (_BAR - full) + "]"

    def close(self) -> None:
        """End a line that is being rewritten."""
        if self._line_open:
            self._stream.write("\n")
            self._stream.flush()
            self._line_open = False
