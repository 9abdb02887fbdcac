"""`mjtactile bench numbers`: the numbers of the README, taken from the pages that the benchmarks
wrote.

It measures nothing, so that a number stands in two places and is written down in one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile.core import resources
from mjtactile.core.errors import InputError

_LARGEST = "largest force, N: median (worst)"

# what to say, page, how the row begins (of several, one after the other), heading of the column, by
# which command
NUMBERS = (
    (
        "normal force felt: mean absolute error (worst), N",
        "benchmarks",
        "normal force, mean absolute",
        "dense",
        "bench touch",
    ),
    (
        "shear force felt: mean absolute error, N",
        "benchmarks",
        "shear force error",
        "dense",
        "bench touch",
    ),
    ("middle of the contact: error, mm", "benchmarks", "contact centroid", "dense", "bench touch"),
    ("touches of 0.03-0.06 N felt", "benchmarks", "touches of 0.03-0.06 N", "dense", "bench touch"),
    (
        "the paper's force test (the paper: 0.04 N)",
        "experiments",
        "5a: force error, cylinder",
        "ours",
        "experiments",
    ),
    ("eggs held, of ten seeds", "benchmarks", "egg", "held", "bench grasp"),
    (
        "grasps held in worlds that vary, egg, strawberry, vial and random things",
        "evaluate",
        "gentle",
        "held",
        "evaluate",
    ),
    ("with what 95 % interval", "evaluate", "gentle", "95 % interval", "evaluate"),
    *(
        (
            f"largest force on a finger with touch / by the servos' current alone, {name}, N: "
            "median (worst)",
            "evaluate",
            f"gentle | {name} / touchless | {name}",
            _LARGEST,
            "evaluate",
        )
        for name in ("egg", "strawberry", "vial", "random")
    ),
    (
        "force while holding an egg: error, mean / worst, N",
        "benchmarks",
        "egg",
        "its error, N: mean / worst",
        "bench grasp",
    ),
    (
        "centres of circles in space: mean error, nearer of two poses, mm",
        "benchmarks",
        "mean centre error, nearer",
        "measured",
        "bench perception",
    ),
    (
        "the same as returned, mm",
        "benchmarks",
        "mean centre error, as returned",
        "measured",
        "bench perception",
    ),
    (
        "grasp with two cameras at 30 Hz, x real time on the processor that is named there",
        "accuracy",
        "30 Hz loop, all",
        "now",
        "bench speed",
    ),
    (
        "two cameras at 60 Hz, touch to release, on the same",
        "accuracy",
        "60 Hz loop, touch to release",
        "now",
        "bench speed",
    ),
    (
        "the same, times as fast as before the compiled chain, in turns",
        "accuracy",
        "60 Hz loop, touch to release",
        "ratio",
        "bench speed",
    ),
    ("materials named right", "benchmarks", "material class right", "measured", "bench material"),
    (
        "faults of the emulated rig that ended safely",
        "benchmarks",
        "safe state after a fault",
        "measured",
        "bench rig",
    ),
)


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Read the pages of the checkout or of the installed package. Raises InputError naming a page
    that lacks a number."""
    folder = resources.folder("docs")
    pages = {
        name: (folder / f"{name}.md").read_text(encoding="utf-8")
        for name in {page for _, page, *_ in NUMBERS}
    }
    return {
        "numbers": [
            {
                "what": what,
                "value": cell(pages[page], row, column, source=page),
                "page": page,
                "by": by,
            }
            for what, page, row, column, by in NUMBERS
        ]
    }


def table(result: Mapping[str, Any]) -> str:
    """The result as Markdown."""
    rows = [
        f"| {n['what']} | {n['value']} | [`{n['by']}`](docs/{n['page']}.md) |"
        for n in result["numbers"]
    ]
    return "\n".join(["| what | measured | by |", "|---|---|---|", *rows]) + "\n"


def cell(page: str, row: str, column: str, *, source: str) -> str:
    """The cell under the heading `column` in the first row that begins with `row`, of the tables
    that have that column; of rows "a / b" both, of the first table that has both."""
    for heading, *rows in _tables(page):
        texts = [" | ".join(cells) for cells in rows]
        found = [
            next((k for k, text in enumerate(texts) if text.startswith(one)), None)
            for one in row.split(" / ")
        ]
        if column in heading and None not in found:
            return " / ".join(rows[k][heading.index(column)] for k in found if k is not None)
    raise InputError(
        f"has no table with a row {row!r} and a column {column!r}", source=f"docs/{source}.md"
    )


def _tables(page: str) -> list[list[list[str]]]:
    """The cells of each row of each table, its heading first."""
    tables: list[list[list[str]]] = [[]]
    for line in page.splitlines():
        if line.startswith("|"):
            tables[-1].append([text.strip() for text in line.strip().strip("|").split(" | ")])
        elif tables[-1]:
            tables.append([])
    return [table for table in tables if table]
