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
from benchmarks.reference_cases.measure import ESTIMATE, Number, measure
from mjtactile.core.errors import SimulationError
from mjtactile.runtime.progress import Progress

QUICK = 4  # cases


def run(
    out: Path,
    quick: bool = False,
    notify: Callable[[str], None] | None = None,
    *,
    cases: Path | None = None,
) -> dict[str, Any]:
    """Measure every case of the folder `cases` (default: the shipped ones).

    It plots `out`/references.png and returns the JSON object.
    """
    notify = Progress().message if notify is None else notify
    known = load_cases(cases)
    rows = []
    for case in known[:QUICK] if quick else known:
        rows.append(_row(case))
        notify(f"{case.name}: {_verdict(rows[-1])}")
    result = {
        "cases": rows,
        "numbers": sum(len(row["numbers"]) for row in rows),
        "met": sum(n["is_met"] for row in rows for n in row["numbers"]),
    }
    plots.save(out / "references.png", rows)
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
    """Return a Markdown table.

    Each row is the value of a case and kind with the largest error relative to its requirement. The
    estimate stands next to the first value of its case.
    """
    lines = [
        "The value with the largest error relative to the allowed one; cases that meet all "
        "requirements in one row.",
        "",
        "| case | quantity | reference | error | allowed | met | estimate minus simulation | "
        "allowed | met |",
        "|---" * 9 + "|",
    ]
    complete: list[dict[str, Any]] = []
    for row in result["cases"]:
        about = row["about"]
        if "failed" in row:
            lines.append(f"| {about} | failed: {row['failed']} |{' |' * 7}")
            continue
        if all(number["is_met"] for number in row["numbers"]):
            complete.append(row)
            continue
        kinds = dict.fromkeys(n["quantity"] for n in row["numbers"] if n["quantity"] != ESTIMATE)
        estimates = [n for n in row["numbers"] if n["quantity"] == ESTIMATE]
        for quantity in kinds:
            values = [n for n in row["numbers"] if n["quantity"] == quantity]
            lines.append(f"| {about} | {_simulated(quantity, values)} | {_estimated(estimates)} |")
            estimates = []
    if complete:
        count = sum(len(row["numbers"]) for row in complete)
        names = "; ".join(row["about"] for row in complete)
        lines.append(f"| {names} |{' |' * 4} {count} of {count} |{' |' * 3}")
    lines.append(f"| all |{' |' * 4} {result['met']} of {result['numbers']} |{' |' * 3}")
    return "\n".join(lines) + "\n"


def _simulated(quantity: str, numbers: Sequence[dict[str, Any]]) -> str:
    worst = _worst(numbers)
    unit = f" {worst['unit']}" if worst["unit"] else ""
    fraction = (
        f" ({100 * worst['error'] / worst['reference']:+.1f} %)" if worst["reference"] else ""
    )
    return (
        f"{quantity}, {worst['at']} | {worst['reference']:.4g}{unit} | "
        f"{worst['error']:+.2g}{fraction} | {worst['allowed']:.2g} | {_met(numbers)}"
    )


def _estimated(numbers: Sequence[dict[str, Any]]) -> str:
    if not numbers:
        return " | | "
    worst = _worst(numbers)
    sd = f", {abs(worst['error']) / worst['sd']:.1f} sd" if worst["sd"] else ""
    return f"{worst['error']:+.2g} N{sd} | {worst['allowed']:.2g} | {_met(numbers)}"


def _worst(numbers: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return max(numbers, key=lambda n: abs(n["error"]) / (n["allowed"] or 1e-300))


def _met(numbers: Sequence[dict[str, Any]]) -> str:
    return f"{sum(n['is_met'] for n in numbers)} of {len(numbers)}"
