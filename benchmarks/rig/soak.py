"""Hours of the 60 Hz loop with repeated grips of an egg, and a fault every five minutes.

The whole run is recorded. A leg lies between two faults: a connection, its grips, a fault at a
random time, the safe state. An interrupted run continues with its next leg.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig.faults import FAULTS, KeptBench, Stopwatch
from benchmarks.rig.loop import RATE, RIG
from benchmarks.rig.session import Bench, EndOfRun, drive
from mjtactile.core import scaled_clock
from mjtactile.core.types import Command, Observation
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.rig.finger import Rig
from mjtactile.runtime.cycle import Cycle

# time from fault to fault, and from grip to grip, s
LEG = 300.0
GRIP = 20.0
_WATCH = 3.0  # time limit for the loop's reaction, s
_FRAMES = 60  # cycles from one recorded image to the next: one a second


@dataclass
class RepeatedGrips:
    """Controller that grips with an estimated `force`, N, during the first 0.6 of each `period`, s.

    It releases for the remainder, and repeats without end.
    """

    period: float = GRIP
    force: float = 0.4
    touch: float = 0.08  # contact threshold, N
    speed: float = 0.02  # closing speed, m/s
    gain: float = 0.03  # gain, m/s of opening per N
    path: Path = Path("soak")

    def step(self, observation: Observation) -> Command:
        last = observation.command
        estimated = observation.touch[0].force_normal
        memory = {"start": observation.time, "open": last.opening, **last.memory}
        into = (observation.time - memory["start"]) % self.period
        if not math.isfinite(estimated):
            speed = 0.0
        elif into > 0.6 * self.period:
            speed = self.speed
        elif estimated < self.touch:
            speed = -self.speed
        else:
            speed = self.gain * (estimated - self.force)
        opening = min(last.opening + speed * observation.period, memory["open"])
        return replace(last, opening=opening, force_limit=2.0, memory=memory)


def sampled(number: int, leg: float, grip: float) -> tuple[str, float]:
    """Sample the fault of leg `number` and its time after the start, s.

    Every kind occurs once before any repeats. The time lies within the last `grip` s of the `leg`.
    """
    around, place = divmod(number, len(FAULTS))
    kind = list(FAULTS)[np.random.default_rng(around).permutation(len(FAULTS))[place]]
    return kind, leg - grip * np.random.default_rng(number).random()


class SoakBench(KeptBench):
    """Legs in turn; recordings of failed legs stay in `out`."""

    def __init__(self, out: Path, *, leg: float = LEG, grip: float = GRIP) -> None:
        super().__init__(RIG, RATE)
        self.leg = leg
        self._out = out
        self._grip = grip

    def run(self, number: int) -> dict[str, Any]:
        """Run leg `number`, which determines its fault and the time of it."""
        kind, at = sampled(number, self.leg, self._grip)
        bench = self.bench()
        folder = self._out / f"leg-{number:03d}"
        shutil.rmtree(folder, ignore_errors=True)  # left by an interrupted run
        leg = _Leg(bench, kind, at, self._grip)
        with Recorder(folder, {"controller": "soak", "fault": kind}, frames=_FRAMES) as recorder:
            outcome = drive(
                bench,
                RepeatedGrips(self._grip),
                lambda cycle: leg.add(cycle, recorder),
                supervisor=leg.supervisor,
                time_limit=self.leg + 60,
                on_ready=leg.start,
            )
            recorder.close(outcome=outcome)
        result = leg.result(outcome) | {
            "recording": _read_back(folder, leg.cycles),
            "process": os.getpid(),
            "memory_MB": memory_MB(),
        }
        if result["safe"] and not result["recording"]:
            shutil.rmtree(folder)
        self.recover(kind)
        return result


class _Leg:
    """State of one leg. Each cycle only writes to preallocated arrays, so that memory growth is due
    to the loop."""

    def __init__(self, bench: Bench, kind: str, at: float, grip: float):
        self._bench = bench
        self._kind = kind
        self._at = at
        self._grip = grip
        self.supervisor = Stopwatch(1 / RATE)
        # time, s; estimated force, N; 1 while running
        self._rows = np.full((int(1.1 * RATE * (at + 60)), 3), np.nan)
        self.cycles = 0
        self._injected = 0.0
        self._rig: Rig | None = None

    def start(self, rig: Rig) -> None:
        self._rig = rig

    def add(self, cycle: Cycle, recorder: Recorder) -> None:
        recorder.add(cycle)
        if not self._injected and self.cycles < len(self._rows):
            self._rows[self.cycles] = (
                cycle.time,
                cycle.touch[0].force_normal,
                cycle.state == "running",
            )
        self.cycles += 1
        if not self._injected and cycle.time - self._rows[0, 0] > self._at:
            self._injected = scaled_clock.monotonic()
            self._bench.process.fault(self._kind, FAULTS[self._kind])
        if self._injected and scaled_clock.monotonic() - self._injected > _WATCH:
            raise EndOfRun

    def result(self, outcome: str) -> dict[str, Any]:
        """Return the statistics before the fault, and its outcome.

        `safe` is true if the loop left "running" within `_WATCH` of it.
        """
        rows = self._rows[np.isfinite(self._rows[:, 0])]
        intervals = np.diff(rows[:, 0])
        estimated = rows[rows[:, 1] > 0.5 * RepeatedGrips.force, 0] - rows[:1, 0]
        reaction = self.supervisor.reaction(self._injected)
        return {
            "fault": self._kind,
            "seconds": float(np.ptp(rows[:, 0])) if len(rows) else 0.0,
            "cycles": len(rows),
            "missed": int((intervals > 1.5 / RATE).sum()),
            "not_running": int((rows[:, 2] == 0).sum()),
            "grips": len(np.unique(estimated // self._grip)),
            "injected": self._injected > 0,
            "safe": reaction is not None,
            "reaction_s": reaction,
            "outcome": outcome or self.supervisor.reason,
        }


def _read_back(folder: Path, cycles: int) -> str:
    """Return the defect of a leg's recording ("": none).

    A separate process reads it, so that this one's memory is that of the loop.
    """
    done = subprocess.run(
        [sys.executable, "-m", __name__, str(folder)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        return done.stderr.strip().splitlines()[-1]
    return "" if int(done.stdout) == cycles else f"{done.stdout.strip()} of {cycles} cycles"


def soak_rows(legs: list[dict[str, Any]], late: float = 0.2) -> list[tuple[str, str, str]]:
    """Return rows for the table of `mjtactile bench rig`."""
    hours = sum(leg["seconds"] for leg in legs) / 3600
    cycles = sum(leg["cycles"] for leg in legs)
    missed = sum(leg["missed"] for leg in legs)
    times = [leg["reaction_s"] for leg in legs if leg["reaction_s"] is not None]
    spontaneous = [leg for leg in legs if not leg["injected"]]
    unread = sum(bool(leg["recording"]) for leg in legs)
    return [
        (
            f"long run of {hours:.2f} h, {sum(leg['grips'] for leg in legs)} grips of an egg: "
            "missed cycles",
            "< 0.5 %",
            f"{100 * missed / max(cycles, 1):.2f} % of {cycles}",
        ),
        (
            "long run: safe state after a fault at a random time",
            "always, within 200 ms",
            f"{sum(leg['safe'] for leg in legs)} of {len(legs) - len(spontaneous)}, "
            f"{sum(t > late for t in times)} later than "
            f"{1e3 * late:.0f} ms, worst {1e3 * max(times, default=math.nan):.0f} ms",
        ),
        (
            "long run: stops without a fault",
            "none",
            f"{len(spontaneous)} of {len(legs)} legs"
            + "".join(f"; {leg['outcome'][:80]}" for leg in spontaneous[:1]),
        ),
        ("long run: memory", "constant", growth(legs)),
        ("long run: unreadable recordings", "none", f"{unread} of {len(legs)}"),
    ]


def growth(legs: list[dict[str, Any]]) -> str:
    """Describe the memory of the process that ran the largest number of legs.

    It is given after the second leg, half of the legs and the last leg.
    """
    by_process: dict[int, list[float]] = {}
    for leg in legs:
        by_process.setdefault(leg["process"], []).append(leg["memory_MB"])
    longest = max(by_process.values(), key=len)
    if len(longest) < 3:
        return f"{longest[-1]:.0f} MB; too few legs for a trend"
    counts = sorted({2, max(2, len(longest) // 2), len(longest)})
    return ", ".join(f"{longest[count - 1]:.1f} MB after {count} legs" for count in counts)


def memory_MB() -> float:
    """Return the memory of this process, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    sys.stdout.write(str(len(load_recording(sys.argv[1]).column("time"))))
