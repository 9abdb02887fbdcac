"""`mjtactile bench grasp`: three fragile objects with ten seeds; outcome, force error, speed, and
where the time goes."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.recording.observer import Observer
from mjtactile.report.figures import new_figure
from mjtactile.runtime.grasp import GraspResult, run_grasp
from mjtactile.runtime.progress import Progress

OBJECTS = ("egg", "strawberry", "vial")  # the other shipped objects are for probing
SEEDS = range(10)


class _MarkerErrors(Observer):
    """Observer that keeps the marker errors and writes no files, so that the loop is timed."""

    def __init__(self) -> None:
        self.marker_errors: list[float] = []

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        self.marker_errors += truth.get("marker_error_true", [])


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Grasp each of OBJECTS with the dense sensor; return one row per run, also for failed runs."""
    rows = []
    notify = Progress().message
    for name in OBJECTS:
        for seed in SEEDS[:1] if quick else SEEDS:
            row = _row(Scenario(object=name, controller="gentle", seed=seed))
            rows.append(row)
            notify(_line(row))
    _plot(rows, out)
    objects = {name: _summary(group) for name, group in _by_object(rows).items()}
    return {"sensor": "dense", "runs": rows, "objects": objects}


def _line(row: Mapping[str, Any]) -> str:
    start = f"{row['object']} seed {row['seed']}: {row['outcome']}"
    if "error" in row:
        return f"{start}: {row['error']}"
    return (
        f"{start}, hold {row['hold_force_N']:.2f} N (true {row['hold_force_true_N']:.2f} N), "
        f"{row['real_time_factor']:.2f} x real time"
    )


def _row(scenario: Scenario) -> dict[str, Any]:
    observed_errors = _MarkerErrors()
    try:
        result: GraspResult = run_grasp(scenario, [observed_errors])
    except MjtactileError as error:
        return {
            "object": scenario.object,
            "seed": scenario.seed,
            "outcome": "fault",
            "error": str(error),
        }
    errors = [1e3 * error for error in observed_errors.marker_errors if error == error]
    return {
        **result.summary(),
        "marker_error_mm_mean": statistics.fmean(errors) if errors else float("nan"),
        "milliseconds": dict(result.milliseconds),
    }


def _by_object(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    return {
        name: [row for row in rows if row["object"] == name]
        for name in dict.fromkeys(row["object"] for row in rows)
    }


def _summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    done = [row for row in rows if "milliseconds" in row]
    result: dict[str, Any] = {
        "runs": len(rows),
        "held": sum(row["outcome"] == "held" for row in rows),
        "crushed": sum(row["outcome"] == "crushed" for row in rows),
    }
    if not done:
        return result

    def median(key: str) -> float:
        return statistics.median(row[key] for row in done)

    errors = [row["hold_force_N"] - row["hold_force_true_N"] for row in done]
    return result | {
        "hold_force_true_N": median("hold_force_true_N"),
        "hold_force_error_N_mean": statistics.fmean(errors),
        "hold_force_error_N_worst": max(errors, key=abs),
        "peak_force_true_N": max(row["peak_force_true_N"] for row in done),
        "slip_mm_true": median("slip_mm_true"),
        "marker_error_mm_mean": median("marker_error_mm_mean"),
        "real_time_factor": median("real_time_factor"),
        "milliseconds": {
            part: statistics.median(row["milliseconds"][part] for row in done)
            for part in done[0]["milliseconds"]
        },
    }


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    lines = [
        "| object | held | crushed | grip force (ground truth), N | force error (estimate minus "
        "ground truth), N: mean / worst | peak force (ground truth), N | slip (ground truth), mm "
        "| marker error, mm |",
        "|---" * 8 + "|",
    ]
    for name, s in result["objects"].items():
        if "milliseconds" not in s:
            lines.append(f"| {name} | {s['held']} of {s['runs']} | {s['crushed']} |" + " |" * 5)
            continue
        lines.append(
            f"| {name} | {s['held']} of {s['runs']} | {s['crushed']} | "
            f"{s['hold_force_true_N']:.2f} | {s['hold_force_error_N_mean']:+.3f} / "
            f"{s['hold_force_error_N_worst']:+.3f} | {s['peak_force_true_N']:.2f} | "
            f"{s['slip_mm_true']:.2f} | {s['marker_error_mm_mean']:.3f} |"
        )
    return "\n".join([*lines, "", _fraction_table(result)]) + "\n"


_PARTS = {
    "rest": "waiting for physics, rendering, ground truth",
    "camera": "reading images",
    "perception": "perception",
    "controller": "controller",
}


def _fraction_table(result: Mapping[str, Any]) -> str:
    """Return the fractions of a control cycle's wall time, both fingers together, in percent.

    Absolute times are left to `bench speed`, which runs without other load.
    """
    lines = [
        f"| fraction of a control cycle | {' | '.join(_PARTS.values())} |",
        "|---" * (len(_PARTS) + 1) + "|",
    ]
    for name, s in result["objects"].items():
        if "milliseconds" not in s:
            continue
        parts = [s["milliseconds"][part] for part in _PARTS]
        fractions = [f"{100 * part / sum(parts):.0f} %" for part in parts]
        lines.append(f"| {name} | {' | '.join(fractions)} |")
    return "\n".join(lines)


def _plot(rows: Sequence[Mapping[str, Any]], out: Path) -> None:
    """Plot the error of the estimated hold force in every run."""
    if (figure := new_figure("grasp.png", (7.2, 4.4))) is None:
        return
    axes = figure.add_subplot()
    axes.axhspan(-0.15, 0.15, color="#00000010", linewidth=0, label="± 0.15 N")
    axes.axhline(0, color="black", linewidth=0.8)
    done = [row for row in rows if "milliseconds" in row]
    for name, group in _by_object(done).items():
        axes.plot(
            [r["seed"] for r in group],
            [r["hold_force_N"] - r["hold_force_true_N"] for r in group],
            "o-",
            label=name,
        )
    axes.set_xlabel("seed")
    axes.set_xticks(sorted({row["seed"] for row in rows}))
    axes.set_ylabel("force error (estimate minus ground truth) [N]")
    axes.set_title("normal force on a finger, mean over the hold phase")
    axes.legend(ncols=4, loc="upper center")
    figure.savefig(out / "grasp.png")
