"""`mjtactile bench design`: predictions of `mjtactile design` against full simulation.

A ball is pressed into the shipped sensors at random positions to random depths, and its force is
estimated from rendered images. No parameter was tuned on these seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mjtactile.core.design import load_sensor
from mjtactile.design_study.prediction_check import check, verdict
from mjtactile.recording.files import write_json

SENSORS = ("paper16", "dense", "fine")
SEED = 100
PLACES = 4


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Press into each sensor, and return one row per sensor.

    Results so far are stored in `out`/design.json.
    """
    rows: list[dict[str, Any]] = []
    for name in SENSORS:
        notify(name)
        design = load_sensor(name)
        presses = check(design, positions=1 if quick else PLACES, seed=SEED, notify=notify)
        rows.append({"sensor": name} | asdict(verdict(presses)))
        write_json(Path(out) / "design.json", {"rows": rows, "quick": quick})
    return {"rows": rows, "quick": quick}


def table(result: Mapping[str, Any]) -> str:
    """Format the rows as a Markdown table."""
    rows = result["rows"]

    def line(words: str, value: Callable[[Mapping[str, Any]], str]) -> str:
        return f"| {words} | " + " | ".join(value(row) for row in rows) + " |"

    return "\n".join(
        [
            "|  | " + " | ".join(row["sensor"] for row in rows) + " |",
            "|---" * (len(rows) + 1) + "|",
            line("contacts", lambda row: str(row["count"])),
            line("force, rms error, mN", lambda row: f"{1e3 * row['force_rms']:.1f}"),
            line("force error / predicted sd", lambda row: f"{row['force_ratio']:.2f}"),
            line("force error / reported sd", lambda row: f"{row['reported_ratio']:.2f}"),
            line("position, rms error, mm", lambda row: f"{1e3 * row['place_rms']:.2f}"),
            line("position error / predicted sd", lambda row: f"{row['place_ratio']:.2f}"),
        ]
    )
