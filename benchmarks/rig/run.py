"""`mjtactile bench rig`: the emulated rig's loop, latency, fault reactions, killed host, corrupted
bytes, grasps.

The host and the emulator share this computer's processors. Other load makes the numbers worse, so
the load average is stored with them. `MJTACTILE_TIME_SCALE=4` is for a computer that is slower than
real time. Each part is written when it is done; `resume` continues with the missing parts.
"""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.rig import faults, fuzz, host_pause, loop
from benchmarks.rig.soak import LEG, SoakBench, soak_rows
from mjtactile.core import scaled_clock
from mjtactile.core.errors import InputError
from mjtactile.recording.files import to_json, write_json
from mjtactile.runtime.progress import Progress

PARTS = ("loop", "bus", "fuzz", "killed", "stopped", "stuck", "outcomes", "faults")
# only on request
SOAK = "soak"
HOURS = 2.0


def run(
    out: Path,
    *,
    quick: bool,
    resume: bool = False,
    parts: tuple[str, ...] = PARTS,
    soak: float | None = None,
) -> dict[str, Any]:
    """Run all `parts`.

    With `quick` each fault is injected twice instead of 20 times, and the other parts are shortened
    likewise. `soak`: duration of the additional long run, h.
    """
    unknown = [part for part in parts if part not in (*PARTS, SOAK)]
    if unknown:
        raise InputError(f"unknown part {unknown[0]!r}", field="--parts", choices=(*PARTS, SOAK))
    store = _Store(out / "rig.json", resume)
    times, seconds, count, seeds = (2, 10.0, 10**5, 1) if quick else (20, 300.0, 10**7, 3)
    work: dict[str, Callable[[], None]] = {
        "loop": lambda: store.once("loop", lambda: loop.measure_loop(seconds)),
        "bus": lambda: store.once("bus", loop.measure_bus),
        "fuzz": lambda: store.once(
            "fuzz", lambda: {"servos": fuzz.fuzz_servos(count), "valve": fuzz.fuzz_valve(count)}
        ),
        "killed": lambda: store.repeat(
            "killed", 3 * min(times, 3), lambda i: faults.killed(list(faults.DEAD)[i % 3])
        ),
        "stopped": lambda: _stopped(store, times),
        "stuck": lambda: store.repeat("stuck", min(times, 5), lambda _: faults.stuck()),
        "outcomes": lambda: store.repeat("outcomes", seeds, faults.outcome),
        "faults": lambda: _faults(store, times),
    }
    for part in PARTS:
        if part in parts:
            work[part]()
    if soak is not None or SOAK in parts:
        _soak(
            store,
            SoakBench(out / SOAK, leg=30.0 if quick else LEG),
            HOURS if soak is None else soak,
        )
    store.result |= {"load_average": os.getloadavg()[0], "slow": scaled_clock.slow()}
    return store.result


class _Store:
    """The results so far, on disk after each step."""

    def __init__(self, path: Path, resume: bool):
        self._path = path
        self.result: dict[str, Any] = (
            json.loads(path.read_text()) if resume and path.is_file() else {}
        )
        self._notify = Progress().message

    def once(self, part: str, measure: Callable[[], Any]) -> None:
        if part not in self.result:
            self._notify(f"rig: {part}")
            self.keep(part, measure())

    def repeat(self, part: str, times: int, measure: Callable[[int], Any]) -> None:
        while len(self.result.get(part, [])) < times:
            done = self.result.get(part, [])
            self._notify(f"rig: {part}, {len(done) + 1} of {times}")
            self.keep(part, [*done, measure(len(done))])

    def keep(self, part: str, value: Any) -> None:
        self.result[part] = to_json(value)
        write_json(self._path, self.result)


def _soak(store: _Store, bench: SoakBench, hours: float) -> None:
    try:
        store.repeat(SOAK, max(1, round(3600 * hours / bench.leg)), bench.run)
    finally:
        bench.end()


def _stopped(store: _Store, times: int) -> None:
    """Run `times` cases with "hold", and a few with "open" for comparison."""
    few = min(times, 3)
    store.repeat("stopped", times, lambda i: host_pause.stopped(i, "hold"))
    store.repeat("stopped", times + few, lambda i: host_pause.stopped(i, "open"))


def _faults(store: _Store, times: int) -> None:
    """Inject each kind of fault in turn, repeatedly.

    An interrupted run thus has similar counts of all kinds.
    """
    bench = faults.FaultBench()
    try:
        for count in range(1, times + 1):
            for kind, value in faults.FAULTS.items():
                store.repeat(
                    f"fault:{kind}",
                    count,
                    lambda _, kind=kind, value=value: bench.react(kind, value),
                )
    finally:
        bench.end()


def table(result: dict[str, Any]) -> str:
    """Return the result in Markdown, next to the requirements."""
    lines = [
        "| quantity | required | measured |",
        "|---|---|---|",
        *(f"| {a} | {b} | {c} |" for a, b, c in _rows(result)),
    ]
    lines += ["", f"Load average: {result.get('load_average', float('nan')):.1f}.", ""]
    if (slow := result.get("slow", 1.0)) != 1:
        lines += [
            f"Devices, host and their clock ran at 1/{slow:g} of real time: 1 ms in this table is "
            f"{slow:g} ms of wall time.",
            "",
        ]
    faults = {
        key.removeprefix("fault:"): rows for key, rows in result.items() if key.startswith("fault:")
    }
    if faults:
        lines += ["| fault | safe | reaction time, median / worst, ms |", "|---|---|---|"]
    for kind, rows in faults.items():
        median, worst = _reactions(rows)
        lines.append(
            f"| {kind} | {sum(r['safe'] for r in rows)} of {len(rows)} | {median:.0f} / "
            f"{worst:.0f} |"
        )
    return "\n".join(lines) + "\n"


def _reactions(rows: list[dict[str, Any]]) -> tuple[float, float]:
    times = [1e3 * r["reaction_s"] for r in rows if r["reaction_s"] is not None] or [float("nan")]
    return statistics.median(times), max(times)


def _rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    rows: list[tuple[str, str, str]] = []
    for part, make in (
        ("loop", _loop_rows),
        (SOAK, soak_rows),
        ("bus", _bus_rows),
        ("killed", _killed_rows),
        ("stopped", host_pause.stopped_rows),
        ("outcomes", _outcome_rows),
        ("fuzz", _fuzz_rows),
        ("stuck", _stuck_rows),
    ):
        if part in result:
            rows += make(result[part])
    faults = [row for key, found in result.items() if key.startswith("fault:") for row in found]
    if faults:
        _, worst = _reactions(faults)
        late = sum((r["reaction_s"] or 0) > 0.2 for r in faults)
        rows.append(
            (
                "safe state after a fault, time from its injection",
                "always, within 200 ms",
                f"{sum(r['safe'] for r in faults)} of "
                f"{len(faults)}, {late} later than 200 ms, worst {worst:.0f} ms",
            )
        )
    return rows


_PARTS = {
    "picture's age when looked at": "image age at the start of a cycle",
    "servos read, perception, controller, command": "servo read to command",
    "of it perception": "perception",
    "state's age": "servo state age",
}


def _loop_rows(loop: dict[str, Any]) -> list[tuple[str, str, str]]:
    cpu = loop["cpu"]
    parts = loop["parts_median_ms"]
    return [
        (
            "control loop with a 60 Hz camera, two servos, valve",
            "60 Hz",
            f"{loop['rate_Hz']:.1f} Hz, jitter {loop['jitter_ms']:.1f} ms",
        ),
        (
            "image capture to command, median / 99th percentile",
            "25 / 45 ms",
            f"{loop['capture_to_command_median_ms']:.1f} / {loop['capture_to_command_p99_ms']:.1f} "
            f"ms (10th percentile {loop['capture_to_command_p10_ms']:.1f})",
        ),
        (
            "its parts, median",
            "",
            ", ".join(f"{_PARTS.get(name, name)} {value:.1f}" for name, value in parts.items())
            + " ms",
        ),
        (
            "missed cycles",
            "< 0.5 %",
            f"{loop['missed_percent']:.2f} % of {loop['cycles']} in {loop['seconds']:.0f} s",
        ),
        (
            "processors used",
            "",
            f"host {cpu['host']:.2f}, emulated world {cpu['world']:.2f}, emulated devices "
            f"{cpu['devices']:.2f}; load average {cpu['load_average']:.1f}",
        ),
    ]


def _bus_rows(bus: dict[str, Any]) -> list[tuple[str, str, str]]:
    return [
        (
            "time to read two servos, median / 99th percentile",
            "",
            f"{bus['read_2_servos_median_ms']:.2f} / {bus['read_2_servos_p99_ms']:.2f} ms",
        )
    ]


_REACTIONS = {"goes on": "none (continue)", "limp": "torque off"}


def _killed_rows(runs: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Return a row for each kind of servo, with the worst of its runs."""

    def worst(kind: str, key: str) -> float | None:
        values = [run[key] for run in runs if run["kind"] == kind]
        return None if None in values else max(values)

    def time(kind: str, key: str) -> str:
        value = worst(kind, key)
        return "never" if value is None else f"after {1e3 * value:.0f} ms"

    def amount(kind: str, key: str) -> str:
        return f"{worst(kind, key):.2f}"

    return [
        (
            f"host killed while an egg is held, servo reaction: {_REACTIONS.get(kind, kind)}",
            "300 ms",
            f"watchdogs {time(kind, 'servos_stopped_s')}, valves vented "
            f"{time(kind, 'valves_vented_s')}; {amount(kind, 'squeeze_before_N')} N "
            f"before, {amount(kind, 'squeeze_after_N')} N a second later; jaws closed by "
            f"{amount(kind, 'closed_by_mm')} mm",
        )
        for kind in dict.fromkeys(run["kind"] for run in runs)
    ]


def _outcome_rows(runs: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    rows = []
    for run in runs:
        sim = run["sim"]
        emulated = run["emulated"]
        text = f"simulated {sim['outcome']}, emulated {emulated['outcome']}"
        for key, name in (("hold_force_N", "estimate"), ("hold_drive_N", "from the drive")):
            a = sim[key]
            b = emulated[key]
            text += (
                (f"; {name} {a:.3f} and {b:.3f} N ({100 * (b / a - 1):+.1f} %)") if a and b else ""
            )
        rows.append((f"grasp of an egg, seed {run['seed']}: grip force", "within 10 %", text))
    return rows


def _fuzz_rows(fuzz: dict[str, Any]) -> list[tuple[str, str, str]]:
    return [
        (
            f"corrupted bytes sent to the {name} driver",
            "10^7, none wrong accepted",
            f"{r['bytes']}: {r['wrong']} wrong accepted, longest call "
            f"{1e3 * r['longest_s']:.0f} ms",
        )
        for name, r in fuzz.items()
    ]


def _stuck_rows(runs: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    return [
        (
            "stuck valve detected",
            "always",
            f"{sum(r['safe'] for r in runs)} of {len(runs)}: {runs[0]['outcome'][:80]}",
        )
    ]
