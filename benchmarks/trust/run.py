"""`mjtactile bench trust`: one egg grasp felt again with its images changed, as cameras do.

Each trouble at a strength of its own seed, from the references on ("always"), after them alone
("run"), or in them alone; felt against true normal force of one finger.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.accuracy.run import stamp
from benchmarks.trust.kinds import kinds
from benchmarks.trust.pictures import draw
from benchmarks.trust.replay import FAR_N, FAR_SD, feel, numbers, record
from mjtactile.run.progress import Progress

SENSORS = ("dense",)
GRASP_SEED = 4


def run(
    out: Path, *, quick: bool = False, say: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """All kinds on each sensor, or every second one; draws the pictures into `out`."""
    say = say or Progress().message
    rows = []
    for sensor in SENSORS:
        grasp = record(sensor, GRASP_SEED)
        if not rows:
            draw(grasp, out / "camera_troubles.png")
        for kind in islice(kinds(), 0, None, 2 if quick else 1):
            row = {
                "sensor": sensor,
                "name": kind.name,
                "when": kind.when,
                "strength": dict(kind.table),
                **numbers(grasp, feel(grasp, kind)),
            }
            rows.append(row)
            say(_line(row))
    return {"stamp": stamp(), "grasp_seed": GRASP_SEED, "rows": rows, "sums": _sums(rows)}


def _line(row: Mapping[str, Any]) -> str:
    head = f"{row['sensor']}, {row['name']}, {row['when']}"
    if row["refused"]:
        return f"{head}: refused"
    worst = "-" if row["worst_N"] is None else f"{row['worst_N']:.3f} N"
    return f"{head}: {row['ok']} of {row['images']} ok, {row['far']} far, worst {worst}"


def _sums(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Of each sensor: images, how many are ok, and of these how many far off."""
    return {
        sensor: {
            key: sum(row[key] for row in rows if row["sensor"] == sensor)
            for key in ("images", "ok", "far")
        }
        for sensor in SENSORS
    }


def table(result: Mapping[str, Any]) -> str:
    """Markdown."""
    lines = []
    for sensor in SENSORS:
        rows = [row for row in result["rows"] if row["sensor"] == sensor]
        if not rows:
            continue
        total = result["sums"][sensor]
        lines += [
            f"`{sensor}`, an egg of {rows[0]['images']} images: of {total['images']} images "
            f"{total['ok']} are `ok`, and of these {total['far']} "
            f"({100 * total['far'] / max(total['ok'], 1):.2f} %) are beyond {FAR_SD:g} sd and "
            f"{FAR_N:g} N.",
            "",
            "| trouble | when | felt less true, N: rms / worst | sd, N | ok | far | else |",
            "|---|---|---|---|---|---|---|",
            *(_row(row) for row in rows),
            "",
        ]
    return "\n".join(lines)


def _row(row: Mapping[str, Any]) -> str:
    strength = ", ".join(f"{key} {_short(value)}" for key, value in row["strength"].items())
    name = f"{row['name']} (`{strength}`)" if strength else row["name"]
    if row["refused"]:
        return f"| {name} | {row['when']} | | | 0 | 0 | references refused |"
    off = "" if row["rms_N"] is None else f"{row['rms_N']:.3f} / {row['worst_N']:.2f}"
    sd = "" if row["sd_N"] is None else f"{row['sd_N']:.3f}"
    other = ", ".join(f"{n} {code}" for code, n in row["status"].items() if code != "ok")
    return f"| {name} | {row['when']} | {off} | {sd} | {row['ok']} | {row['far']} | {other} |"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(f"{one:.3g}" for one in value)
    return f"{value:.3g}"
