"""`mjtactile bench benchmark-index`: table of docs/validation/benchmarks.md.

The title of each benchmark comes from its page, and the headline result from a cell of its tables.
Nothing is measured here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.readme_table import cell
from mjtactile.core import resources
from mjtactile.core.errors import InputError


@dataclass(frozen=True)
class Entry:
    """Row of the index."""

    page: str
    """Path of the page from docs/validation."""
    headline: str
    """Description of the result; "{}" stands for the value."""
    row: str
    """Row of the value, as in `benchmarks.readme_table.cell`."""
    column: str


ENTRIES = (
    Entry("../how-to/evaluate", "held, domain randomization: {}", "gentle | all", "held"),
    Entry(
        "controller_comparison",
        "six tasks, held with / without touch: {}",
        "all 6 |",
        "adaptive | touchless",
    ),
    Entry(
        "accuracy",
        "complete grasp, speed relative to real time: {}",
        "30 Hz loop",
        "complete grasp",
    ),
    Entry("paper", "force error (paper: 0.04): {} N", "`dense`, valve closed", "ours"),
    Entry("benchmarks/grasp", "eggs held: {}", "egg", "held"),
    Entry(
        "benchmarks/touch", "normal force error, mean (worst): {} N", "normal force, mean", "dense"
    ),
    Entry("benchmarks/uncertainty", "chi-square of the normal force: {}", "contacts |", "Fz"),
    Entry(
        "benchmarks/shape",
        "area error, median / 90 % within (count): {}",
        "area from 0.2 N, smooth",
        "every touch",
    ),
    Entry("benchmarks/slip", "detected in time: {}", "slips detected before", "measured"),
    Entry("benchmarks/material", "correct class: {}", "correct material class", "measured"),
    Entry(
        "benchmarks/explore",
        "surface error, median: {} mm",
        "**shipped",
        "surface error, rms (95 %), mm",
    ),
    Entry(
        "benchmarks/sliding-faces",
        "standard deviation of the force, largest: {}",
        "largest standard deviation",
        "result",
    ),
    Entry("benchmarks/wide-faces", "plates within 3 %: {}", "with", "plates within"),
    Entry(
        "benchmarks/cube-grasps",
        "holds with an error above 3 % / without a flag: {}",
        "error above / of them without",
        "count",
    ),
    Entry(
        "benchmarks/outline",
        "worst error: {} mN",
        "round30 | 21",
        "error of any component, worst, mN",
    ),
    Entry(
        "benchmarks/relaxation",
        "latex, 600 s: {} mN",
        "latex",
        "worst force error with `[relaxation]`, mN",
    ),
    Entry(
        "benchmarks/perception",
        "mean center error: {} mm",
        "mean center error, returned",
        "measured",
    ),
    Entry("benchmarks/tracking", "wrong markers: {}", "all", "wrong"),
    Entry("benchmarks/rig", "safe states: {}", "safe state after a fault", "measured"),
    Entry("benchmarks/studio", "speed ratio: {}", "speed with Studio", "measured"),
    Entry("benchmarks/references", "requirement met: {} values", "all", "met"),
    Entry("benchmarks/quasistatic", "force, rms (worst): {} %", "balls of 4-30 mm", "41 x 31"),
    Entry("benchmarks/thin-objects", "blade, force ratio: {}", "blade 0.4", "90 % within"),
    Entry(
        "benchmarks/learning",
        "sampled touch: {} steps per second",
        "without mesh, sampled",
        "steps per second of one core",
    ),
)


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Read the pages of the benchmarks.

    Args:
        out: Not used, no plot is written.
        quick: Not used.

    Returns:
        `benchmarks`: `page`, `title`, `headline` (texts) for each of `ENTRIES`.

    Raises:
        InputError: A page has no title or value.
    """
    folder = resources.folder("docs") / "validation"
    rows = []
    for entry in ENTRIES:
        text = (folder / f"{entry.page}.md").read_text(encoding="utf-8")
        source = f"validation/{entry.page}"
        value = cell(text, entry.row, entry.column, source=source)
        rows.append(
            {
                "page": entry.page,
                "title": _found(r"(?m)^# (.+)$", text, source),
                "headline": entry.headline.format(value),
            }
        )
    return {"benchmarks": rows}


def table(result: Mapping[str, Any]) -> str:
    """Return the index as a table in Markdown."""
    rows = [
        f"| [{row['title']}]({row['page']}.md) | {row['headline']} |"
        for row in result["benchmarks"]
    ]
    return "\n".join(["| benchmark | headline result |", "|---|---|", *rows]) + "\n"


def _found(pattern: str, text: str, source: str) -> str:
    found = re.search(pattern, text)
    if found is None:
        raise InputError(f"has no text {pattern!r}", source=f"docs/{source}.md")
    return found[1]
