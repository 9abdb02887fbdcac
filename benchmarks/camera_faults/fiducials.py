"""`mjtactile bench fiducials`: effect of camera changes on sensors with and without fiducials.

Both sensors get the same eggs, seeds and faults, each with and without the pressure sensor. The
benchmark reports the change of the estimated force against the same images without the fault. It
also reports the cost of fiducials per image.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.run import stamp
from benchmarks.camera_faults.error_statistics import numbers
from benchmarks.camera_faults.fault_kinds import ALWAYS, RUN, kinds, label
from benchmarks.camera_faults.replay import Grasp, ReplayResult, record, replay_faults
from mjtactile.runtime.progress import Progress

SENSORS = ("dense", "dense_fiducials")
GRASP_SEEDS = (4, 21, 22, 23)
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
_TURNS = 3  # timed runs of both sensors, in turn


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Evaluate both sensors under each fault of `NAMES`, present after the references.

    With `quick`, one seed and every fourth fault are evaluated.
    """
    notify = notify or Progress().message
    seeds = GRASP_SEEDS[: 1 if quick else None]
    grasps = {}
    rows = []
    for sensor in SENSORS:
        for seed in seeds:
            grasp = record(sensor, seed)
            grasps.setdefault(sensor, grasp)
            notify(f"{sensor}, seed {seed}")
            rows += _rows(sensor, seed, grasp, NAMES[:: 4 if quick else 1], notify)
    return {
        "stamp": stamp(),
        "grasp_seeds": list(seeds),
        "rows": rows,
        "ms": _times(grasps, 1 if quick else _TURNS),
    }


def _rows(
    sensor: str, seed: int, grasp: Grasp, names: Sequence[str], notify: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Evaluate one grasp under each fault, with and without the pressure sensor.

    The first row is the one without a fault.
    """
    rows = []
    clean: Sequence[ReplayResult] = ()
    for kind in kinds():
        if kind.name not in names or kind.when != (ALWAYS if kind.name == "none" else RUN):
            continue
        both = replay_faults(grasp, kind)
        clean = clean or both
        for gauge, estimated, without in zip((True, False), both, clean, strict=True):
            row = _row(grasp, estimated, without)
            head = {"sensor": sensor, "seed": seed, "name": kind.name, "gauge": gauge}
            rows.append({**head, "strength": dict(kind.table), **row})
            notify(f"{kind.name}, gauge {gauge}: worst {row['worst_N']:.3f} N")
    return rows


def _row(grasp: Grasp, estimated: ReplayResult, clean: ReplayResult) -> dict[str, Any]:
    """Compute force errors, and changes against the same images without a fault."""
    forces, usual = (
        np.array([touch.force_normal for touch in item.touches]) for item in (estimated, clean)
    )
    changed = forces - usual
    return {
        "first_N": float(forces[0] - grasp.true[0]),
        "changed_rms_N": float(np.sqrt(np.nanmean(changed**2))),
        "changed_worst_N": float(np.nanmax(np.abs(changed))),
        **numbers(grasp, estimated),
    }


def _times(grasps: Mapping[str, Grasp], turns: int) -> dict[str, float]:
    """Measure the processor time per image, ms: the minimum over several runs in turn."""
    clean = next(kind for kind in kinds() if kind.name == "none")
    spent: dict[str, list[float]] = {sensor: [] for sensor in grasps}
    for _ in range(turns):
        for sensor, grasp in grasps.items():
            start = time.process_time()
            replay_faults(grasp, clean, gauges=(True,))
            spent[sensor].append((time.process_time() - start) / len(grasp.images))
    return {sensor: 1e3 * float(np.min(each)) for sensor, each in spent.items()}


def table(result: Mapping[str, Any]) -> str:
    """Format the results over all seeds in Markdown: one row per fault, both sensors."""
    plain, fixed = SENSORS
    seeds = ", ".join(map(str, result["grasp_seeds"]))
    lines = [
        f"Egg grasps of seeds {seeds}, N. Cells: rms/largest force error; rms/largest change by "
        "the fault; largest error in the first image after the references. *: no pressure sensor.",
        "",
        f"| fault after the references | `{plain}` | `{fixed}` | `{plain}`* | `{fixed}`* |",
        "|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(row["name"] for row in result["rows"]):
        cells = [
            _cell([row for row in result["rows"] if _is(row, name, sensor, gauge)])
            for gauge in (True, False)
            for sensor in SENSORS
        ]
        lines.append(f"| {label(name)} | {' | '.join(cells)} |")
    ms = result["ms"]
    lines += [
        "",
        f"Processor time per image: {ms[plain]:.2f} ms, with fiducials {ms[fixed]:.2f} ms.",
    ]
    return "\n".join(lines)


def _is(row: Mapping[str, Any], name: str, sensor: str, gauge: bool) -> bool:
    return (row["name"], row["sensor"], row["gauge"]) == (name, sensor, gauge)


def _cell(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format the result of one fault and one sensor over all seeds."""
    known = [row for row in rows if row["rms_N"] is not None]
    if not known:
        return "none ok"

    def rms(key: str) -> float:
        return float(np.sqrt(np.mean([row[key] ** 2 for row in known])))

    def worst(key: str) -> float:
        return max(abs(row[key]) for row in known)

    text = (
        f"{rms('rms_N'):.3f}/{worst('worst_N'):.2f}; {rms('changed_rms_N'):.3f}/"
        f"{worst('changed_worst_N'):.3f}; {worst('first_N'):.3f}"
    )
    unknown = sum(row["images"] - row["ok"] for row in rows)
    far = sum(row["far"] for row in rows)
    return text + (f"; {unknown} not ok" if unknown else "") + (f"; {far} far" if far else "")
