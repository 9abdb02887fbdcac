"""`mjtactile bench fiducials`: a camera that changes, felt by a sensor with fiducials and by one
without.

The same egg, seed and troubles for both; each with the pressure gauge and without; and what
fiducials cost an image.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.run import stamp
from benchmarks.trust.kinds import ALWAYS, RUN, Kind, kinds
from benchmarks.trust.numbers import numbers
from benchmarks.trust.replay import Grasp, feel, record
from mjtactile.run.progress import Progress

SENSORS = ("dense", "dense_fiducials")
GRASP_SEED = 4
NAMES = (
    "none",
    "knock of 0.5 px",
    "knock of 2 px",
    "knock of 6 px",
    "turn of 0.2 degrees",
    "zoom by 0.1 %",
    "zoom by 0.3 %",
    "zoom by -0.3 %",
    "zoom by 1 %",
    "defocus of 1 px",
    "gamma 1.3",
    "gamma 0.8",
    "blacks clipped at 50 DN",
    "whites clipped at 150 DN",
)
_TURNS = 3  # of both sensors, in turn, for the time


def run(
    out: Path, *, quick: bool = False, say: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Both sensors under each of `NAMES`, after the references; `quick`: every fourth."""
    say = say or Progress().message
    grasps = {sensor: record(sensor, GRASP_SEED) for sensor in SENSORS}
    wanted = NAMES[:: 4 if quick else 1]
    rows = []
    for kind in kinds():
        if kind.name not in wanted or kind.when != (ALWAYS if kind.name == "none" else RUN):
            continue
        for sensor, grasp in grasps.items():
            for gauge in (True, False):
                row = _row(sensor, grasp, kind, gauge=gauge)
                rows.append(row)
                say(f"{sensor}, {kind.name}, gauge {gauge}: worst {row['worst_N']:.3f} N")
    return {
        "stamp": stamp(),
        "grasp_seed": GRASP_SEED,
        "rows": rows,
        "ms": _prices(grasps, 1 if quick else _TURNS),
    }


def _row(sensor: str, grasp: Grasp, kind: Kind, *, gauge: bool) -> dict[str, Any]:
    (felt,) = feel(grasp, kind, gauges=(gauge,))
    found = numbers(grasp, felt)
    first = felt.touches[0].force_normal - grasp.true[0]
    return {
        "sensor": sensor,
        "name": kind.name,
        "strength": dict(kind.table),
        "gauge": gauge,
        "first_N": float(first),
        **found,
    }


def _prices(grasps: Mapping[str, Grasp], turns: int) -> dict[str, float]:
    """Processor time of an image, ms, the least of several runs in turn."""
    clean = next(kind for kind in kinds() if kind.name == "none")
    spent: dict[str, list[float]] = {sensor: [] for sensor in grasps}
    for _ in range(turns):
        for sensor, grasp in grasps.items():
            start = time.process_time()
            feel(grasp, clean, gauges=(True,))
            spent[sensor].append((time.process_time() - start) / len(grasp.images))
    return {sensor: 1e3 * float(np.min(each)) for sensor, each in spent.items()}


def table(result: Mapping[str, Any]) -> str:
    """Markdown: a row for each trouble; rms / worst, the first image, both sensors."""
    plain, fixed = SENSORS
    lines = [
        "| trouble, after the references | "
        f"`{plain}`, N: rms / worst, first image | `{fixed}` | "
        "without gauge | without gauge, fiducials |",
        "|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(row["name"] for row in result["rows"]):
        cells = [
            _cell(row)
            for gauge in (True, False)
            for sensor in SENSORS
            for row in result["rows"]
            if (row["name"], row["sensor"], row["gauge"]) == (name, sensor, gauge)
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    ms = result["ms"]
    lines += [
        "",
        f"Processor time of an image: {ms[plain]:.2f} ms, with fiducials {ms[fixed]:.2f} ms.",
    ]
    return "\n".join(lines)


def _cell(row: Mapping[str, Any]) -> str:
    if row["rms_N"] is None:
        return "none ok"
    text = f"{row['rms_N']:.3f} / {row['worst_N']:.2f}, {row['first_N']:+.3f}"
    if row["ok"] < row["images"]:
        text += f", {row['images'] - row['ok']} not ok"
    return text + (f", {row['far']} far" if row["far"] else "")
