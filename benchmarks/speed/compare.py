"""Comparison of this checkout with another one, in turns.

Compared are the loop at 30 and 60 Hz by phase, the stages, the start-up, and the whole command.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.speed import probe
from mjtactile.core import platform_support
from mjtactile.core.errors import InputError

ROUNDS = 3
RATES = (30.0, 60.0)  # Hz
PHASES = ("approach", *probe.TOUCHING, "release", probe.ALONE)
_HOME = Path(__file__).resolve().parents[2]

Notify = Callable[[str], None]


def compare(other: Path, *, quick: bool, notify: Notify) -> dict[str, Any]:
    """Measure both checkouts `ROUNDS` times in turns, and return the median of each value.

    Raises:
        InputError: `other` is no checkout that runs.
    """
    if not (other / "mjtactile" / "__init__.py").exists():
        raise InputError("no checkout of mjtactile", source=other, field="--baseline")
    rounds: list[dict[str, Any]] = []
    for k in range(1 if quick else ROUNDS):
        rounds.append(
            {
                name: _measure(home, quick)
                for name, home in (("before", other.resolve()), ("now", _HOME))
            }
        )
        notify(
            f"round {k + 1}: {rounds[-1]['now']['loop'][0]['factors']['all']:.2f} x real time at "
            f"30 Hz, before {rounds[-1]['before']['loop'][0]['factors']['all']:.2f}; load "
            f"{os.getloadavg()[0]:.1f}"
        )
    return {"rounds": rounds, "processor": _processor(), "load_average": os.getloadavg()[0]}


def _measure(home: Path, quick: bool) -> dict[str, Any]:
    rates = RATES[:1] if quick else RATES
    return {
        "core": _probe(home, RATES[0], "core"),
        "loop": [_probe(home, rate, "wall") for rate in rates],
        **_command(home),
    }


def _environment(home: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(home), "OPENBLAS_NUM_THREADS": "1"}


def _probe(home: Path, rate: float, kind: str) -> dict[str, Any]:
    command = [sys.executable, str(Path(probe.__file__).resolve()), str(rate), kind]
    with tempfile.TemporaryDirectory() as folder:  # without this folder on Python's path
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, env=_environment(home), cwd=folder
        )
    if done.returncode:
        raise InputError(
            f"does not run: {done.stderr.strip().splitlines()[-1]}", source=home, field="--baseline"
        )
    return json.loads(done.stdout)


def _command(home: Path) -> dict[str, float]:
    """Measure the wall time, s, of `mjtactile --help` and of a whole `mjtactile grasp`.

    The grasp includes recording, scoring and figure.
    """
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, words in (
            ("help_s", ["--help"]),
            (
                "grasp_s",
                ["grasp", "--object", probe.OBJECT, "--controller", "gentle", "--out", "out"],
            ),
        ):
            start = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "mjtactile", *words],
                env=_environment(home),
                cwd=folder,
                check=True,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            seconds[name] = time.perf_counter() - start
    return seconds


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    name = next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.processor(),
    )
    return f"{name}, {platform_support.processors()} processors"


_LABELS = {
    "a step": "step",
    "rendering an image": "rendering",
    "image to touch": "image to estimate",
    "all": "complete grasp",
}


def table(result: Mapping[str, Any]) -> str:
    """Format the comparison in Markdown."""
    rounds = result["rounds"]
    lines = [
        f"Baseline (before) and this version (now), alternating, median of {len(rounds)} runs; "
        f"{result['processor']}, load average {result['load_average']:.1f}. Core time at 30 Hz, "
        "one thread. Gain relative to the baseline: median of the row.",
        "",
    ]

    def values(*keys: str | int) -> tuple[float, float]:
        """Return the medians before and now."""
        before, now = (
            sorted(_at(cell[which], keys) for cell in rounds)[len(rounds) // 2]
            for which in ("before", "now")
        )
        return before, now

    def add(name: str, columns: Sequence[str], known: Container[str], *keys: str | int) -> None:
        cells = [values(*keys, column) if column in known else None for column in columns]
        speed = name.endswith("x real time")
        gain = median(_gain(*cell, speed=speed) for cell in cells if cell is not None)
        shown = ["" if cell is None else f"{cell[1]:.3g}" for cell in cells]
        lines.append(_line(name, [*shown, f"{gain:.2f}"]))

    first = rounds[0]["now"]
    lines += [_line("", [*PHASES, "gain"]), "|---" * (2 + len(PHASES)) + "|"]
    for operation, by_phase in sorted(first["core"]["core_ms"].items()):
        add(
            f"{_LABELS.get(operation, operation)}, ms",
            PHASES,
            by_phase,
            "core",
            "core_ms",
            operation,
        )
    columns = (*PHASES, "touch to release", "all")
    columns = tuple(
        name for name in columns if any(name in cell["factors"] for cell in first["loop"])
    )
    heads = [_LABELS.get(name, name) for name in columns]
    lines += ["", _line("", [*heads, "gain"]), "|---" * (2 + len(columns)) + "|"]
    for k, loop in enumerate(first["loop"]):
        name = f"{RATES[k]:g} Hz loop, x real time"
        add(name, columns, loop["factors"], "loop", k, "factors")
    lines += ["", "| | before | now | gain |", "|---|---|---|---|"]
    for name, keys in (
        ("core time per simulated second, s", ("core", "core_s_per_s")),
        ("imports for a grasp, s", ("core", "import_s")),
        ("reference images of two sensors, s", ("core", "references_s")),
        ("`mjtactile --help`, s", ("help_s",)),
        ("`mjtactile grasp`, complete, s", ("grasp_s",)),
    ):
        before, now = values(*keys)
        gain = _gain(before, now, speed=False)
        lines.append(_line(name, [f"{before:.3g}", f"{now:.3g}", f"{gain:.2f}"]))
    return "\n".join(lines) + "\n"


def _gain(before: float, now: float, *, speed: bool) -> float:
    return now / before if speed else before / now


def _line(name: str, cells: Sequence[str]) -> str:
    return f"| {name} | {' | '.join(cells)} |"


def _at(value: Any, keys: tuple[str | int, ...]) -> float:
    for key in keys:
        value = value[key]
    return value
