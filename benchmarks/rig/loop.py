"""Loop rate, jitter, and the time from an image's capture to the command on the wire."""

from __future__ import annotations

import os
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig.session import Bench, Closing, EndOfRun, design_at, drive
from mjtactile.devices.dynamixel.bus import DynamixelBus
from mjtactile.rig.finger import Rig
from mjtactile.runtime.cycle import Cycle

RIG = "emulated_60"
RATE = 60.0


def measure_loop(seconds: float) -> dict[str, Any]:
    """Measure the loop of one 60 Hz camera, two servos and a valve, at rest."""
    bench = Bench(RIG, design_at(RATE))
    # allocated in advance: later growth is due to the loop
    rows = np.full((int(1.1 * RATE * seconds) + 100, 7), np.nan)
    rigs: list[Rig] = []
    count = 0

    def on_cycle(cycle: Cycle) -> None:
        nonlocal count
        captured = cycle.images[0].time
        sent = rigs[0].gripper.sent_time  # type: ignore[attr-defined]  # the driver's own
        rows[count] = (
            cycle.time,
            sent - captured,
            cycle.time - captured,
            1e-3 * cycle.perception_ms,
            sent - cycle.time,
            cycle.gripper.age,
            cycle.state == "running",
        )
        count += 1
        if cycle.time - rows[0, 0] > seconds or count == len(rows):
            raise EndOfRun

    try:
        usage = _Usage(bench.process.pid)

        def on_ready(rig: Rig) -> None:
            rigs.append(rig)
            usage.start()

        outcome = drive(bench, Closing(0.0), on_cycle, time_limit=seconds + 60, on_ready=on_ready)
        truth = bench.process.truth()
        fraction = usage.shares()
    finally:
        bench.close()
    return _loop_result(rows[:count], outcome) | {
        "world_lost_s": truth["lost"],
        "picture_delay_ms": 1e3 * truth["image_delay"],
        "cpu": fraction,
    }


def _loop_result(rows: np.ndarray, outcome: str) -> dict[str, Any]:
    starts = rows[:, 0]
    period = 1 / RATE
    intervals = np.diff(starts)
    _, latency, age, perception, rest, state_age, running = rows[rows[:, 6] > 0].T

    def ms(values: np.ndarray, percent: float) -> float:
        return float(1e3 * np.percentile(values, percent))

    return {
        "seconds": float(starts[-1] - starts[0]),
        "cycles": len(starts),
        "outcome": outcome,
        "not_running": len(rows) - len(running),
        "rate_Hz": float(1 / intervals.mean()),
        "asked_Hz": RATE,
        "jitter_ms": float(1e3 * intervals.std()),
        "missed_percent": float(100 * (intervals > 1.5 * period).mean()),
        "capture_to_command_median_ms": ms(latency, 50),
        "capture_to_command_p99_ms": ms(latency, 99),
        "capture_to_command_p10_ms": ms(latency, 10),
        "parts_median_ms": {
            "picture's age when looked at": ms(age, 50),
            "servos read, perception, controller, command": ms(rest, 50),
            "of it perception": ms(perception, 50),
            "state's age": ms(state_age, 50),
        },
    }


class _Usage:
    """Processor time of this process and of the emulator's two, as fractions of one processor; and
    the computer's load."""

    def __init__(self, emulator: int):
        children = Path(f"/proc/{emulator}/task/{emulator}/children").read_text().split()
        self._pids = {"devices": emulator, "world": int(children[0]), "host": os.getpid()}
        self.start()

    def start(self) -> None:
        self._start = time.monotonic()
        self._before = self._times()

    def shares(self) -> dict[str, float]:
        passed = time.monotonic() - self._start
        now = self._times()
        return {name: (now[name] - self._before[name]) / passed for name in self._pids} | {
            "load_average": os.getloadavg()[0]
        }

    def _times(self) -> dict[str, float]:
        tick = os.sysconf("SC_CLK_TCK")
        fields = {
            name: Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
            for name, pid in self._pids.items()
        }
        return {name: (int(f[11]) + int(f[12])) / tick for name, f in fields.items()}


def measure_bus() -> dict[str, float]:
    """Measure the round trip time of one sync read of two servos."""
    bench = Bench(RIG, design_at(RATE))
    try:
        bus = DynamixelBus(bench.process.endpoints["servo"], reply_timeout=0.1)
        try:
            durations = []
            for _ in range(500):
                start = time.perf_counter()
                bus.read_many([1, 2], 126, 21)
                durations.append(time.perf_counter() - start)
        finally:
            bus.close()
    finally:
        bench.close()
    return {
        "read_2_servos_median_ms": 1e3 * statistics.median(durations),
        "read_2_servos_p99_ms": float(1e3 * np.percentile(durations, 99)),
    }
