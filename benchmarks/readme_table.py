"""`mjtactile bench readme-table`: values of the README, and those that sentences of pages repeat.

They are copied from the pages that the other benchmarks wrote. Nothing is measured here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjtactile.core import resources
from mjtactile.core.errors import InputError


@dataclass(frozen=True)
class Number:
    """One value, and the cell that it is copied from."""

    quantity: str
    page: str
    """Name of the page in docs/ whose tables have it."""
    row: str
    """Start of the row; "a / b": two rows, shown one after the other."""
    column: str
    """Heading of the column; "a | b": two of them, likewise."""
    command: str
    """The command that measured it."""
    headline: bool = False
    """True if the README shows the number."""


NUMBERS = (
    Number(
        quantity="normal force: mean absolute error (worst), N",
        page="validation/benchmarks/touch",
        row="normal force, mean absolute",
        column="dense",
        command="bench touch",
        headline=True,
    ),
    Number(
        quantity="grasps held: egg, strawberry, vial and random objects, domain randomization",
        page="how-to/evaluate",
        row="gentle",
        column="held",
        command="evaluate",
    ),
    Number(
        quantity="speed of a complete grasp with two cameras at 30 Hz on two cores, x real time",
        page="validation/accuracy",
        row="30 Hz loop",
        column="complete grasp",
        command="bench speed",
        headline=True,
    ),
    Number(
        quantity="slips detected before 0.5 mm and within 100 ms",
        page="validation/benchmarks/slip",
        row="slips detected before",
        column="measured",
        command="bench slip",
    ),
    Number(
        quantity="holds with a false slip alarm",
        page="validation/benchmarks/slip",
        row="holds with a false alarm",
        column="measured",
        command="bench slip",
    ),
    Number(
        quantity="six tasks: objects held without damage, with touch / without",
        page="validation/controller_comparison",
        row="all 6 |",
        column="adaptive | touchless",
        command="bench tasks",
        headline=True,
    ),
    Number(
        quantity="objects placed upright at a height other than specified, with touch / without",
        page="validation/controller_comparison",
        row="place |",
        column="adaptive | touchless",
        command="bench tasks",
        headline=True,
    ),
    Number(
        quantity="six tasks: grip force / minimum holding force, median, with touch / without",
        page="validation/controller_comparison",
        row="grip force relative to required force, all tasks, median |",
        column="adaptive | touchless",
        command="bench tasks",
        headline=True,
    ),
    Number(
        quantity="faults of the emulated rig that end in a safe state",
        page="validation/benchmarks/rig",
        row="safe state after a fault",
        column="measured",
        command="bench rig",
    ),
)


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Read the pages of the checkout or of the installed package.

    Args:
        out: Not used, no plot is written.
        quick: Not used.

    Returns:
        `numbers`: `quantity`, `value` (text), `page`, `command`, `headline` for each of `NUMBERS`.

    Raises:
        InputError: A page lacks a number.
    """
    folder = resources.folder("docs")
    pages = {
        name: (folder / f"{name}.md").read_text(encoding="utf-8")
        for name in {number.page for number in NUMBERS}
    }
    return {
        "numbers": [
            {
                "quantity": number.quantity,
                "value": cell(pages[number.page], number.row, number.column, source=number.page),
                "page": number.page,
                "command": number.command,
                "headline": number.headline,
            }
            for number in NUMBERS
        ]
    }


def table(result: Mapping[str, Any]) -> str:
    """Return the headline numbers as a table in Markdown."""
    rows = [
        f"| {n['quantity']} | {n['value']} | [`{n['command']}`](docs/{n['page']}.md) |"
        for n in result["numbers"]
        if n["headline"]
    ]
    return "\n".join(["| quantity | measured | command |", "|---|---|---|", *rows]) + "\n"


def cell(page: str, row: str, column: str, *, source: str) -> str:
    """Find one cell in the tables of a page.

    Args:
        page: The page's text, Markdown.
        row: Start of the row, without the first "|". "a / b" selects two rows of one table.
        column: The heading of the column. "a | b" selects two columns of the row.
        source: Name of the page, for the error.

    Returns:
        The cell's text in the first table that has the column and the row. Two cells are joined by
        " / ".

    Raises:
        InputError: No table has both.
    """
    beginnings = row.split(" / ")
    columns = column.split(" | ")
    for heading, *rows in _tables(page):
        if not set(columns) <= set(heading):
            continue
        places = [heading.index(column) for column in columns]
        found = [_first(rows, beginning) for beginning in beginnings]
        cells = [cells[at] for cells in found if cells is not None for at in places]
        if len(cells) == len(beginnings) * len(columns):
            return " / ".join(cells)
    raise InputError(
        f"has no table with a row {row!r} and a column {column!r}", source=f"docs/{source}.md"
    )


def _first(rows: list[list[str]], beginning: str) -> list[str] | None:
    for cells in rows:
        if " | ".join(cells).startswith(beginning):
            return cells
    return None


def _tables(page: str) -> list[list[list[str]]]:
    """Return the cells of each row of each table, its heading first."""
    tables: list[list[list[str]]] = [[]]
    for line in page.splitlines():
        if line.startswith("|"):
            tables[-1].append([text.strip() for text in line.strip()[1:-1].split("|")])
        elif tables[-1]:
            tables.append([])
    return [table for table in tables if table]
