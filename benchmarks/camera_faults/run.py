"""`mjtactile bench camera-faults`: one egg grasp, evaluated again with images altered as by faulty
cameras.

The strength of each fault comes from a separate seed. A fault is present from the references on
("always"), after them only ("run"), or in them only. The estimated normal force of one finger is
compared with ground truth, with and without the chamber's pressure sensor. Another part changes the
gas of a sensor in a user's scene.

Each row is stored in a separate file; `--resume` continues from there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.accuracy.run import stamp
from benchmarks.camera_faults import gas_changes
from benchmarks.camera_faults.error_statistics import FAR_N, FAR_SD, numbers
from benchmarks.camera_faults.fault_kinds import Kind, kinds, label
from benchmarks.camera_faults.images import render
from benchmarks.camera_faults.replay import Grasp, record, replay_faults
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

SENSORS = ("dense",)
GRASP_SEED = 4

Notify = Callable[[str], None]
Row = Mapping[str, Any]


def run(
    out: Path, *, quick: bool = False, resume: bool = False, notify: Notify | None = None
) -> dict[str, Any]:
    """Evaluate all faults on each sensor and plot example images in `out`.

    With `quick`, every second fault is evaluated.
    """
    notify = notify or Progress().message
    folder = out / "trust"
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for sensor in SENSORS:
        grasp = record(sensor, GRASP_SEED)
        if not rows:
            render(grasp, out / "camera_faults.png")
        for number, kind in islice(enumerate(kinds()), 0, None, 2 if quick else 1):
            file = folder / f"{sensor}-{number:03}.json"
            if not (resume and file.is_file()):
                write_json(file, _estimated(sensor, grasp, kind))
            rows.append(json.loads(file.read_text(encoding="utf-8")))
            notify(_line(rows[-1]))
    return {
        "stamp": stamp(),
        "grasp_seed": GRASP_SEED,
        "rows": rows,
        "sums": _sums(rows),
        "air": gas_changes.rows(quick),
    }


def _estimated(sensor: str, grasp: Grasp, kind: Kind) -> dict[str, Any]:
    """Evaluate one fault with the pressure sensor, and under "without" without it."""
    estimated, without = (numbers(grasp, found) for found in replay_faults(grasp, kind))
    return {
        "sensor": sensor,
        "name": kind.name,
        "when": kind.when,
        "strength": dict(kind.table),
        **estimated,
        "without": without,
    }


def _line(row: Row) -> str:
    head = f"{row['sensor']}, {row['name']}, {row['when']}"
    if row["refused"]:
        return f"{head}: refused"
    worst = "-" if row["worst_N"] is None else f"{row['worst_N']:.3f} N"
    return f"{head}: {row['ok']} of {row['images']} ok, {row['far']} far, worst {worst}"


def _sums(rows: Sequence[Row]) -> dict[str, Any]:
    """Count images, ok images and large errors for each sensor.

    The last two counts are repeated without the pressure sensor.
    """
    sums = {}
    for sensor in SENSORS:
        selected = [row for row in rows if row["sensor"] == sensor]
        sums[sensor] = {key: sum(row[key] for row in selected) for key in ("images", "ok", "far")}
        for key in ("ok", "far"):
            sums[sensor][f"{key}_without"] = sum(row["without"][key] for row in selected)
    return sums


def table(result: Mapping[str, Any]) -> str:
    """Format the result in Markdown."""
    lines = [*gas_changes.table(result["air"]), ""]
    for sensor in SENSORS:
        rows = [row for row in result["rows"] if row["sensor"] == sensor]
        if not rows:
            continue
        total = result["sums"][sensor]
        names = list(dict.fromkeys(row["name"] for row in rows))
        by_name = {name: [row for row in rows if row["name"] == name] for name in names}
        usual = [name for name in names if name != "none" and _is_usual(by_name[name])]
        lines += [
            f"`{sensor}`, egg grasp of {rows[0]['images']} images: {total['ok']} of "
            f"{total['images']} images are `ok`. {total['far']} of these "
            f"({100 * total['far'] / max(total['ok'], 1):.2f} %) are beyond {FAR_SD:g} sd and "
            f"{FAR_N:g} N; without pressure sensor {total['far_without']} of "
            f"{total['ok_without']}.",
            "",
            "Cells: force error, rms / worst (sd), N. *: without pressure sensor.",
            "",
            "| fault | always | run | always* | run* | only in the references |",
            "|---|---|---|---|---|---|",
            *(_row(by_name[name]) for name in names if name not in usual),
            "",
            *_usual([row for name in usual for row in by_name[name]]),
        ]
    return "\n".join(lines)


def _is_usual(rows: Sequence[Row]) -> bool:
    """Return True if all images are ok and no error exceeds `FAR_N`."""
    return not any(row["refused"] or set(row["status"]) - {"ok"} for row in rows) and not any(
        found["far"] or round(found["worst_N"] or 0.0, 2) > FAR_N
        for row in rows
        for found in (row, row["without"])
    )


def _usual(rows: Sequence[Row]) -> list[str]:
    """Return one row for all faults without effect."""
    if not rows:
        return []

    def at_most(found: Sequence[Row]) -> str:
        rms, worst = (max(item[key] or 0.0 for item in found) for key in ("rms_N", "worst_N"))
        return f"{rms:.3f} / {worst:.2f}"

    names = "; ".join(dict.fromkeys(label(row["name"]) for row in rows))
    return [
        "| without effect | largest rms / worst, N | the same* |",
        "|---|---|---|",
        f"| {names} | {at_most(rows)} | {at_most([row['without'] for row in rows])} |",
        "",
    ]


def _row(rows: Sequence[Row]) -> str:
    """Format the results of one fault."""
    strength = ", ".join(f"{key} {_short(value)}" for key, value in rows[0]["strength"].items())
    name = f"{label(rows[0]['name'])} (`{strength}`)" if strength else label(rows[0]["name"])
    by_time = {row["when"]: row for row in rows}
    cells = [
        _cell(by_time.get(when), gauge=gauge)
        for gauge in (True, False)
        for when in ("always", "run")
    ]
    return f"| {name} | {' | '.join(cells)} | {_cell(by_time.get('references'), gauge=True)} |"


def _cell(row: Row | None, *, gauge: bool) -> str:
    if row is None:
        return ""
    if row["refused"]:
        return "references rejected" if gauge else ""
    if not gauge:
        return _off(row["without"])
    sd = "" if row["sd_N"] is None else f" ({row['sd_N']:.3f})"
    other = "".join(f"; {n} {code}" for code, n in row["status"].items() if code != "ok")
    return f"{_off(row)}{sd}{other}"


def _off(found: Row) -> str:
    far = f"; {found['far']} far" if found["far"] else ""
    return "" if found["rms_N"] is None else f"{found['rms_N']:.3f} / {found['worst_N']:.2f}{far}"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(f"{item:.3g}" for item in value)
    return f"{value:.3g}"
