"""Figure of `mjtactile bench references`, with one panel per case."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mjtactile.report.figures import new_figure

_COLUMNS = 4


def save(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Plot all cases; report a missing matplotlib on stderr."""
    height = math.ceil(len(rows) / _COLUMNS)
    if (figure := new_figure(path.name, (4 * _COLUMNS, 3 * height), dpi=80)) is None:
        return
    boxes = figure.subplots(height, _COLUMNS, squeeze=False).ravel()
    for axes, row in zip(boxes, rows, strict=False):
        _plot(axes, row)
    for axes in boxes[len(rows) :]:
        axes.set_axis_off()
    figure.savefig(path)


def _plot(axes: Any, row: dict[str, Any]) -> None:
    numbers = row["numbers"]
    simulated = [n for n in numbers if n["sd"] is None]
    estimated = [n for n in numbers if n["sd"] is not None]
    places = list(dict.fromkeys(n["at"] for n in numbers))
    axes.errorbar(
        [places.index(n["at"]) for n in simulated],
        [n["reference"] for n in simulated],
        [n["allowed"] for n in simulated],
        fmt="k_",
        capsize=4,
        ms=10,
        label="reference and allowed error",
    )
    axes.plot(
        [places.index(n["at"]) for n in simulated],
        [n["measured"] for n in simulated],
        "o",
        ms=5,
        label="simulated",
    )
    if estimated:
        axes.errorbar(
            [places.index(n["at"]) + 0.15 for n in estimated],
            [n["measured"] for n in estimated],
            [2 * n["sd"] for n in estimated],
            fmt="s",
            ms=4,
            capsize=2,
            color="tab:orange",
            label="estimated, 2 sd",
        )
    axes.set_xticks(range(len(places)), places, fontsize=7, rotation=20 if len(places) > 4 else 0)
    axes.set_title(row["about"], fontsize=9)
    axes.set_ylabel(numbers[0]["unit"] if numbers else row.get("failed", ""), fontsize=8)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=6)
