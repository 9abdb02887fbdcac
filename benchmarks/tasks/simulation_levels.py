"""Simulation levels of the tasks, and agreement of the outcomes at two levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.evaluate.wilson import Line, wilson


@dataclass(frozen=True)
class Level:
    """Simulation level: `effects` as `--effects` takes them, and the description in the table."""

    effects: str
    label: str
    about: str


MESH = "mesh"
LEVELS = {
    MESH: Level(
        "-images", "mesh", "complete membrane; complete pipeline on markers with sampled errors"
    ),
    "quasistatic": Level(
        "-mesh,-images", "quasistatic", "quasi-static membrane; complete pipeline on its markers"
    ),
    "synthetic": Level(
        "-mesh,-pipeline", "synthetic", "quasi-static membrane; touch sampled with pipeline errors"
    ),
}


def folder_of(level: str, worlds: str = "") -> str:
    """Return the folder name of a level's lines; each level has a separate one."""
    return "_".join(part for part in ("tasks", level, worlds) if part)


def agreement(
    controller: str, full: Mapping[str, Sequence[Line]], cheap: Mapping[str, Sequence[Line]]
) -> dict[str, Any]:
    """Compare the episodes of all tasks that one controller ended at both levels.

    Args:
        controller: Name of the controller.
        full: Lines of the mesh level by task.
        cheap: Lines of the other level by task.

    Returns:
        The number of "episodes", the number that ended "alike" (held, dropped, crushed, ...) with
        its 95 % interval, and at each of the two levels "held" and the median "margin".
    """
    pairs = [
        (line, other)
        for task, lines in full.items()
        for line in lines
        for other in cheap.get(task, ())
        if line["controller"] == other["controller"] == controller
        and line["episode"] == other["episode"]
        and "error" not in (line["outcome"], other["outcome"])
    ]
    alike = sum(first["outcome"] == other["outcome"] for first, other in pairs)
    sides = list(zip(*pairs, strict=True)) if pairs else [(), ()]
    return {
        "episodes": len(pairs),
        "alike": alike,
        "alike_interval": list(wilson(alike, len(pairs))) if pairs else [0.0, 1.0],
        "held": [sum(line["outcome"] == "held" for line in side) for side in sides],
        "margin": [_median(side) for side in sides],
    }


def _median(lines: Sequence[Line]) -> float | None:
    known = [line["margin_true"] for line in lines if line.get("margin_true") is not None]
    return float(np.median(known)) if known else None
