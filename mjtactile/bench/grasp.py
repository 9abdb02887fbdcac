"""`mjtactile bench grasp`: every shipped object with ten seeds; outcome, force error, speed, and where the time goes."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mjtactile import resources
from mjtactile.errors import MjtactileError
from mjtactile.grasp import GraspOptions, GraspResult, run_grasp

SEEDS = range(10)


class _Nothing:
    """A recorder and progress display that does nothing, so that only the loop is timed."""

    def note(self, **values: Any) -> None: ...
    def add(self, cycle: Any, **truth: Any) -> None: ...
    def message(self, text: str) -> None: ...
    def update(self, phase: str, time: float, force: float) -> None: ...


def run(out: Path, *, quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Grasp every shipped object with the dense sensor; one row a run. A run that fails is a row too."""
    rows = []
    for name in resources.names("models/objects", ".xml"):
        for seed in SEEDS[:1] if quick else SEEDS:
            row = _row(GraspOptions(object=name, sensor="dense", seed=seed))
            rows.append(row)
            say(_line(row))
    _plot(rows, out, say)
    objects = {name: _summary(group) for name, group in _by_object(rows).items()}
    return {"sensor": "dense", "runs": rows, "objects": objects}


def _line(row: Mapping[str, Any]) -> str:
    start = f"{row['object']} seed {row['seed']}: {row['outcome']}"
    if "error" in row:
        return f"{start}: {row['error']}"
    return (f"{start}, hold {row['hold_force_N']:.2f} N (true {row['hold_force_true_N']:.2f} N), "
            f"{row['real_time_factor']:.2f} x real time")


def _row(options: GraspOptions) -> dict[str, Any]:
    nothing = _Nothing()
    try:
        result: GraspResult = run_grasp(options, recorder=nothing, progress=nothing)
    except MjtactileError as error:
        return {"object": options.object, "seed": options.seed, "outcome": "fault", "error": str(error)}
    return {**result.summary(), "milliseconds": dict(result.milliseconds)}


def _by_object(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    return {name: [row for row in rows if row["object"] == name] for name in dict.fromkeys(row["object"] for row in rows)}


def _summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    done = [row for row in rows if "milliseconds" in row]
    result: dict[str, Any] = {"runs": len(rows), "held": sum(row["outcome"] == "held" for row in rows),
                              "crushed": sum(row["outcome"] == "crushed" for row in rows)}
    if not done:
        return result

    def median(key: str) -> float:
        return statistics.median(row[key] for row in done)

    errors = [row["hold_force_N"] - row["hold_force_true_N"] for row in done]
    return result | {
        "hold_force_true_N": median("hold_force_true_N"),
        "hold_force_error_N_mean": statistics.fmean(errors), "hold_force_error_N_worst": max(errors, key=abs),
        "peak_force_true_N": max(row["peak_force_true_N"] for row in done), "slip_mm_true": median("slip_mm_true"),
        "real_time_factor": median("real_time_factor"),
        "milliseconds": {part: statistics.median(row["milliseconds"][part] for row in done)
                         for part in done[0]["milliseconds"]},
    }  # fmt: skip


def table(result: Mapping[str, Any]) -> str:
    """The result as Markdown."""
    lines = ["| object | held | crushed | hold force, N (true) | its error, N: mean / worst | peak, N (true) "
             "| slip, mm (true) | x real time |", "|---|---|---|---|---|---|---|---|"]
    for name, s in result["objects"].items():
        if "milliseconds" not in s:
            lines.append(f"| {name} | {s['held']} of {s['runs']} | {s['crushed']} | | | | | |")
            continue
        lines.append(f"| {name} | {s['held']} of {s['runs']} | {s['crushed']} | {s['hold_force_true_N']:.2f} "
                     f"| {s['hold_force_error_N_mean']:+.3f} / {s['hold_force_error_N_worst']:+.3f} "
                     f"| {s['peak_force_true_N']:.2f} | {s['slip_mm_true']:.2f} | {s['real_time_factor']:.2f} |")
    return "\n".join([*lines, "", _time_table(result)]) + "\n"


def _time_table(result: Mapping[str, Any]) -> str:
    """Where a control cycle's time goes; what is not camera or perception is physics, controller and truth."""
    lines = ["| ms a control cycle (both fingers) | camera | perception | controller | physics and the rest | whole |",
             "|---|---|---|---|---|---|"]
    for name, s in result["objects"].items():
        ms = s.get("milliseconds")
        if ms:
            controller = ms.get("controller", 0.0)
            rest = ms["cycle"] - ms["camera"] - ms["perception"] - controller
            lines.append(f"| {name} | {ms['camera']:.1f} | {ms['perception']:.1f} | {controller:.2f} | {rest:.1f} "
                         f"| {ms['cycle']:.1f} |")
    return "\n".join(lines)


def _plot(rows: Sequence[Mapping[str, Any]], out: Path, say: Callable[[str], None]) -> None:
    """Felt against true hold force, every run."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        say("no plot: matplotlib is not installed (pip install 'mjtactile[plots]')")
        return
    figure = Figure(figsize=(6.4, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    done = [row for row in rows if "milliseconds" in row and row["hold_force_N"] == row["hold_force_N"]]
    for name, group in _by_object(done).items():
        axes.plot([r["hold_force_true_N"] for r in group], [r["hold_force_N"] for r in group], "o", alpha=0.7, label=name)
    low, high = axes.get_xlim()
    axes.plot([low, high], [low, high], color="black", linewidth=0.8, label="felt = true")
    axes.fill_between([low, high], [low - 0.15, high - 0.15], [low + 0.15, high + 0.15], color="black", alpha=0.06)
    axes.set_xlabel("true normal force per finger, mean over the hold phase [N]")
    axes.set_ylabel("felt normal force, same [N]")
    axes.set_title("hold force, one dot a run; grey: ± 0.15 N")
    axes.legend()
    figure.savefig(out / "grasp.png")
