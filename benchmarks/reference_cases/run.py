"""`mjtactile bench references`: simulation and estimated forces against external references.

All results are on one page.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.reference_cases import plots
from benchmarks.reference_cases.cases import Case, load_cases
from benchmarks.reference_cases.measure import Number, measure
from mjtactile.core.errors import SimulationError
from mjtactile.runtime.progress import Progress

QUICK = 4  # cases


def run(
    out: Path,
    quick: bool = False,
    say: Callable[[str], None] | None = None,
    *,
    cases: Path | None = None,
) -> dict[str, Any]:
    """Measure every case of the folder `cases` (default: those that come along); `truth.png` into
    `out`; the JSON."""
    say = Progress().message if say is None else say
    known = load_cases(cases)
    rows = []
    for case in known[:QUICK] if quick else known:
        rows.append(_row(case))
        say(f"{case.name}: {_verdict(rows[-1])}")
    result = {
        "cases": rows,
        "numbers": sum(len(row["numbers"]) for row in rows),
        "met": sum(n["is_met"] for row in rows for n in row["numbers"]),
    }
    plots.save(out / "truth.png", rows)
    return result


def _row(case: Case) -> dict[str, Any]:
    about = {
        "name": case.name,
        "about": case.about,
        "motion": case.motion,
        "sensor": case.design.name,
        "source": case.source,
        "asked_percent": case.percent,
        "asked_least": case.minimum,
    }
    try:
        numbers = measure(case)
    except SimulationError as error:
        return about | {"numbers": [], "failed": " ".join(str(error).split())}
    return about | {"numbers": [_number(number) for number in numbers]}


def _number(number: Number) -> dict[str, Any]:
    return asdict(number) | {"error": number.error, "is_met": number.is_met}


def _verdict(row: dict[str, Any]) -> str:
    if "failed" in row:
        return f"failed: {row['failed']}"
    return (
        f"{sum(n['is_met'] for n in row['numbers'])} of {len(row['numbers'])} meet the requirement"
    )


def table(result: dict[str, Any]) -> str:
    """Return a Markdown table and the sources of the references.

    Each row is the number of a case and kind with the largest error relative to its requirement.
    """
    lines = [
        f"{result['met']} of {result['numbers']} values meet the requirement. Each row shows the "
        "value with the largest error relative to the allowed one.",
        "",
        "| case | quantity | at | reference | measured | error | allowed error | met |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in result["cases"]:
        if "failed" in row:
            lines.append(f"| {row['about']} | failed: {row['failed']} | | | | | | 0 |")
        for what in dict.fromkeys(n["what"] for n in row["numbers"]):
            lines.append(_line(row["about"], [n for n in row["numbers"] if n["what"] == what]))
    sources = dict.fromkeys(row["source"] for row in result["cases"])
    return "\n".join([*lines, "", "References:", "", *(f"- {one}" for one in sources), ""])


def _line(about: str, numbers: Sequence[dict[str, Any]]) -> str:
    worst = max(numbers, key=lambda n: abs(n["error"]) / (n["allowed"] or 1e-300))
    unit = f" {worst['unit']}" if worst["unit"] else ""
    sd = f", {abs(worst['error']) / worst['sd']:.1f} sd" if worst["sd"] else ""
    share = (
        (f" ({100 * worst['error'] / worst['reference']:+.1f} %)")
        if worst["reference"] and not sd
        else ""
    )
    met = sum(n["is_met"] for n in numbers)
    return (
        f"| {about} | {worst['what']} | {worst['at']} | {worst['reference']:.4g}{unit} | "
        f"{worst['measured']:.4g} | {worst['error']:+.2g}{share}{sd} | {worst['allowed']:.2g} | "
        f"{met} of {len(numbers)} |"
    )
