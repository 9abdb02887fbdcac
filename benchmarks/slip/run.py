"""`mjtactile bench slip`: random slips and holds between two sensors, from pixels.

It counts detections, their latency, and false alarms. Seeds below FIRST_SEED were used in tuning
and are excluded. `score` defines a slip and a detection in time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scenes.slip_cases import SlipCase, sample_slip_case
from benchmarks.slip import active_slip_test, operating_curve
from benchmarks.slip.evaluate_case import Sample, Watched, references, watch
from benchmarks.slip.score import OUTCOMES, SLIPS, Frame, outcome
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.evaluate.wilson import wilson
from mjtactile.report.figures import new_figure
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState

FIRST_SEED = 2000
CASES = 200
CASES_QUICK = 4
RATES = (30.0, 60.0)  # rates of the cameras, Hz
SENSOR = "dense"
PARTS = ("passive", "tested")
"""Parts: passive slip indicators alone; and with the test, which changes the grip, in a separate
run.
"""
_FINGERS = ("left", "right")
_SEEN = 2.5  # images in which the first 0.5 mm pass, for a slip that the camera can follow

Notify = Callable[[str], None]
Row = dict[str, Any]


def run(
    out: Path,
    *,
    quick: bool = False,
    episodes: int = 0,
    rate: float = 0.0,
    parts: tuple[str, ...] = PARTS,
    notify: Notify = lambda _: None,
) -> dict[str, Any]:
    """Evaluate random cases.

    Args:
        out: Folder for slip.png.
        quick: Four cases.
        episodes: Number of cases (0: all).
        rate: Rate of the cameras, Hz (0: the sensor's own).
        parts: Some of `PARTS`; each has rows of the table.
        notify: Receiver of a message for each case.

    Returns:
        The summary of each part, with a row for each finger of each case.

    Raises:
        InputError: A part or a rate does not exist.
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise InputError(f"unknown part {unknown[0]!r}", field="--parts", choices=PARTS)
    at = rate or load_sensor(SENSOR).camera.rate
    if at not in RATES:
        raise InputError(f"{at:g} Hz", field="--rate", choices=[f"{rate:g}" for rate in RATES])
    count = episodes or (CASES_QUICK if quick else CASES)
    seeds = range(FIRST_SEED, FIRST_SEED + count)
    rows: dict[str, list[Row]] = {part: [] for part in parts}
    with ProcessPoolExecutor(max_workers=1 if quick else os.cpu_count()) as pool:
        for part in parts:
            test = part == PARTS[1]
            for found in pool.map(partial(case_rows, test=test, rate=at), seeds):
                rows[part] += found
                notify(
                    f"{found[0]['seed']} {found[0]['case']}{', tested' * test}: "
                    + ", ".join(row["outcome"] for row in found)
                )
    result = summary(rows.get("passive", []), at) | {"rate_Hz": at}
    if "tested" in rows:
        result["with_test"] = with_test(rows["tested"])
    plot(result, Path(out) / "slip.png")
    return result


def with_test(rows: Sequence[Row]) -> dict[str, Any]:
    """Count slips that the test detects within 0.4 s of their onset, and alarms in holds."""
    evaluated = [row for row in rows if row["outcome"] in OUTCOMES]
    slips = [row for row in evaluated if row["outcome"] in SLIPS]
    holds = [row["outcome"] for row in evaluated if row["outcome"] in ("quiet", "false")]
    reported = [row for row in slips if row["outcome"] not in ("missed", "early")]
    in_time = sum(row["latency_ms"] <= 1e3 * active_slip_test.IN_TIME + 0.1 for row in reported)
    kinds = sorted({row["case"] for row in slips})
    return {
        "rows": list(rows),
        "curve": operating_curve.curve(evaluated, active_slip_test.IN_TIME),
        "slips": len(slips),
        "in_time": in_time,
        "in_time_interval": wilson(in_time, len(slips)),
        "early": sum(row["outcome"] == "early" for row in slips),
        "holds": len(holds),
        "false": holds.count("false"),
        "false_interval": wilson(holds.count("false"), len(holds)),
        "by_case": {
            kind: [
                sum(row["case"] == kind and row["latency_ms"] <= 400.1 for row in reported),
                sum(row["case"] == kind for row in slips),
            ]
            for kind in kinds
        },
    }


def case_rows(seed: int, test: bool = False, rate: float = RATES[0]) -> list[Row]:
    """Return rows of both fingers of one case.

    A failed simulation gives one row without a finger. With `test` the result of the test counts,
    not that of the pipeline.
    """
    case = sample_slip_case(seed)
    design, sensing_pipeline, rest = _sensor(rate)
    try:
        return rows_of(case, watch(design, sensing_pipeline, rest, case, test=test), test)
    except SimulationError as error:
        return [
            {
                "seed": seed,
                "case": case.name,
                "body": case.body,
                "outcome": "not simulated",
                "error": str(error),
            }
        ]


def rows_of(case: SlipCase, watched: Watched, test: bool = False) -> list[Row]:
    """Return one row for each finger."""
    rows = []
    for name, friction, samples in zip(_FINGERS, case.friction, watched.fingers, strict=True):
        excluded = active_slip_test.vetoes(samples) if test else [False] * len(samples)
        frames = [
            Frame(k.time, "sticking" if no else _state(k), k.used, k.slid, k.onset)
            for k, no in zip(samples, excluded, strict=True)
        ]
        signs = [
            [sign and not no for sign in k.signs] for k, no in zip(samples, excluded, strict=True)
        ]
        found = outcome(frames)
        rows.append(
            {
                "seed": case.seed,
                "case": case.name,
                "body": case.body,
                "finger": name,
                "friction": friction,
                "force_N": samples[0].force,
                "outcome": found.name,
                "latency_ms": 1e3 * found.latency,
                "slid_mm": 1e3 * found.slid,
                "speed_mm_s": 1e3 * found.speed,
                "flags": sorted(watched.flags),
                "seconds": samples[-1].time - samples[0].time,
                "scales": [asdict(alarm) for alarm in operating_curve.alarms(frames, signs)],
            }
        )
    return rows


def _state(sample: Sample) -> str:
    return sample.touch.slip.state if sample.touch.slip else "unknown"


@cache
def _sensor(rate: float) -> tuple[SensorDesign, SensingPipeline, PipelineState]:
    """Return the sensor, its chain, and its references, measured once per process."""
    design = load_sensor(SENSOR)
    design = replace(design, camera=replace(design.camera, rate=rate))
    sensing_pipeline = SensingPipeline(design)
    return design, sensing_pipeline, references(design, sensing_pipeline, sample_slip_case(0))


def summary(rows: Sequence[Row], rate: float = RATES[0]) -> dict[str, Any]:
    """Compute counts and fractions; `rate` is that of the cameras, Hz."""
    evaluated = [row for row in rows if row["outcome"] in OUTCOMES]
    slow = 0.5 * rate / _SEEN  # mm/s
    groups = {"all slips": [row for row in evaluated if row["outcome"] in SLIPS]}
    groups[f"up to {slow:.0f} mm/s"] = [
        row for row in groups["all slips"] if row["speed_mm_s"] <= slow
    ]
    groups["faster"] = [row for row in groups["all slips"] if row["speed_mm_s"] > slow]
    for key in ("case", "body"):
        for value in sorted({row[key] for row in groups["all slips"]}):
            groups[value] = [row for row in groups["all slips"] if row[key] == value]
    holds = [row["outcome"] for row in evaluated if row["outcome"] in ("quiet", "false")]
    detected = [row for row in groups["all slips"] if row["outcome"] not in ("missed", "early")]
    false = holds.count("false") + sum(row["outcome"] == "early" for row in groups["all slips"])
    return {
        "rows": rows,
        "curve": operating_curve.curve(evaluated),
        "cases": len({row["seed"] for row in rows}),
        "not_simulated": sum(row["outcome"] == "not simulated" for row in rows),
        "between": sum(row["outcome"] == "between" for row in evaluated),
        "groups": {name: _group(group) for name, group in groups.items()},
        "holds": len(holds),
        "false": holds.count("false"),
        "false_interval": wilson(holds.count("false"), len(holds)),
        "precision": len(detected) / max(len(detected) + false, 1),
        "precision_interval": wilson(len(detected), len(detected) + false),
        **{key: _quantiles([row[key] for row in detected]) for key in ("latency_ms", "slid_mm")},
    }


def _group(rows: Sequence[Row]) -> dict[str, Any]:
    """Count slips, and those detected in time, before 0.5 mm, within 100 ms, and later."""
    names = [row["outcome"] for row in rows]
    counts = {
        "in_time": names.count("in time"),
        "before": names.count("in time") + names.count("before 0.5 mm"),
        "soon": names.count("in time") + names.count("within 100 ms"),
        "detected": len(names) - names.count("missed") - names.count("early"),
    }
    return {
        "slips": len(names),
        **counts,
        "in_time_interval": wilson(counts["in_time"], len(names)),
    }


def _quantiles(values: Sequence[float]) -> list[float]:
    return [float(v) for v in np.percentile(values, [50, 90])] if values else [np.nan, np.nan]


def table(result: Mapping[str, Any]) -> str:
    """Return the result as Markdown, next to the requirements."""

    def fraction(count: int, of: int) -> str:
        return f"{100 * count / of:.0f} % ({count} of {of})" if of else "none"

    def interval(bounds: Sequence[float]) -> str:
        return f"{100 * bounds[0]:.0f}-{100 * bounds[1]:.0f} %"

    every = result["groups"]["all slips"]
    test = result.get("with_test")
    lines = [
        "| quantity | required | measured | 95 % interval |",
        "|---|---|---|---|",
        "| slips detected before 0.5 mm and within 100 ms | 65 % | "
        f"{fraction(every['in_time'], every['slips'])} | {interval(every['in_time_interval'])} |",
        f"| holds with a false alarm | 2 % | {fraction(result['false'], result['holds'])} "
        f"| {interval(result['false_interval'])} |",
        f"| precision: slips among alarms |  | {100 * result['precision']:.0f} % "
        f"| {interval(result['precision_interval'])} |",
        f"| detection latency, median (90 %), ms | 100 | {result['latency_ms'][0]:.0f} "
        f"({result['latency_ms'][1]:.0f}) |  |",
        f"| slip distance at detection, median (90 %), mm | 0.5 | {result['slid_mm'][0]:.2f} "
        f"({result['slid_mm'][1]:.2f}) |  |",
    ]
    if test is not None:
        lines += [
            "| with the active test: slips detected within 400 ms | 90 % | "
            f"{fraction(test['in_time'], test['slips'])} | {interval(test['in_time_interval'])} |",
            "| with the active test: holds with a false alarm | 2 % | "
            f"{fraction(test['false'], test['holds'])} | {interval(test['false_interval'])} |",
        ]
    lines += [
        "",
        f"Cameras at {result['rate_Hz']:g} Hz; {result['cases']} cases, two fingers each. "
        f"{result['between']} fingers neither slipped by 0.5 mm nor held with a margin. "
        f"{result['not_simulated']} cases could not be simulated.",
        "",
        "| slips | fingers | both criteria | before 0.5 mm | within 100 ms | detected | with the "
        "active test, within 400 ms |",
        "|---" * 7 + "|",
    ]
    for name, group in result["groups"].items():
        counts = " | ".join(
            str(group[key]) for key in ("slips", "in_time", "before", "soon", "detected")
        )
        reported = None if test is None else test["by_case"].get(name)
        lines.append(
            f"| {name} | {counts} | {f'{reported[0]} of {reported[1]}' if reported else ''} |"
        )
    lines += ["", operating_curve.table(result["curve"], test["curve"] if test else [])]
    return "\n".join(lines)


def plot(result: Mapping[str, Any], path: Path) -> None:
    """Plot the latency of each detected slip over its speed, the outcomes by kind of case, and the
    operating curves."""
    if (figure := new_figure(path.name, (13.2, 4.2))) is None:
        return
    left, right, curves = figure.subplots(1, 3)
    for name, points in (
        ("passive", result["curve"]),
        ("active test", result.get("with_test", {}).get("curve", [])),
    ):
        curves.plot(
            [point["per_minute"] for point in points],
            [100 * point["in_time"] for point in points],
            "o-",
            label=name,
        )
        for point in points:  # the scale of the limits; 1 is the pipeline
            place = point["per_minute"], 100 * point["in_time"]
            curves.annotate(
                f"{point['scale']:g}",
                place,
                (2, -9),
                textcoords="offset points",
                fontsize="x-small",
            )
    curves.set(xlabel="false alarms per minute of hold", ylabel="slips in time [%]", ylim=(0, 100))
    curves.set_title("limits of the evidence, relative: 1 is the pipeline", fontsize="small")
    curves.legend()
    rows = result["rows"]
    slips = [row for row in rows if row["outcome"] in SLIPS]
    for name, color in (
        ("in time", "#1f5fa8"),
        ("before 0.5 mm", "#5fa05f"),
        ("within 100 ms", "#d08020"),
        ("late", "#c0221c"),
    ):
        selected = [row for row in slips if row["outcome"] == name]
        left.plot(
            [row["speed_mm_s"] for row in selected],
            [row["latency_ms"] for row in selected],
            "o",
            ms=4,
            color=color,
            label=name,
        )
    left.axhline(100, color="black", linewidth=0.6)
    left.set(
        xscale="log",
        xlabel="speed over the first 0.5 mm [mm/s]",
        ylabel="detected after the slip began [ms]",
    )
    left.legend()
    names = sorted({row["case"] for row in slips})
    before = np.zeros(len(names))
    for outcome_name, color in zip(
        SLIPS, ("#1f5fa8", "#5fa05f", "#d08020", "#c0221c", "#888888", "#000000"), strict=True
    ):
        count = np.array(
            [
                sum(r["case"] == name and r["outcome"] == outcome_name for r in slips)
                for name in names
            ]
        )
        right.barh(names, count, left=before, color=color, label=outcome_name)
        before += count
    right.set_xlabel("fingers that slipped")
    right.legend(fontsize="small", ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    figure.savefig(path)
