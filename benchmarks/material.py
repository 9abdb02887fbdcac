"""`mjtactile bench material`: probe unseen random objects, and compare the results with ground
truth.

The seed sets sizes, stiffnesses, relaxation times, yield forces and positions. The shipped objects
and the seeds below FIRST_SEED were used in tuning and are excluded.
"""

from __future__ import annotations

import math
import statistics
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.recording.files import write_json
from mjtactile.report.figures import new_figure
from mjtactile.runtime.probe import ProbeResult, run_probe
from mjtactile.sim.scenes.material_samples import Kind, MaterialSample, to_mjcf

FIRST_SEED = 4000
KINDS: tuple[Kind, ...] = ("rigid", "elastic", "viscoelastic", "plastic")
OBJECTS = 48
OBJECTS_QUICK = 4
TARGETS = {"class_right": (0.93, 0.98), "modulus_within_2": (0.85, 0.95)}


def random_material_sample(seed: int) -> MaterialSample:
    """Sample the object of a seed; four consecutive seeds are one of each kind."""
    rng = np.random.default_rng(seed)

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    kind = KINDS[seed % len(KINDS)]
    length, width, height = (
        float(rng.uniform(*limits)) for limits in ((0.018, 0.032), (0.014, 0.022), (0.013, 0.020))
    )
    if kind == "rigid":
        shape = ("box", "cylinder", "sphere")[int(rng.integers(3))]
        return MaterialSample(
            kind, length, length if shape == "cylinder" else width, height, shape=shape
        )
    if kind == "elastic":
        stiffness = spread(120, 4000)
        return MaterialSample(
            kind,
            length,
            width,
            height,
            stiffness=stiffness,
            stiffening=float(rng.uniform(0, 0.5)) * stiffness**2,
        )
    if kind == "viscoelastic":
        stiffness = spread(150, 1500)
        return MaterialSample(
            kind,
            length,
            width,
            height,
            stiffness=stiffness,
            arm_stiffness=stiffness * float(rng.uniform(0.5, 2.5)),
            relaxation_time=spread(0.15, 1.0),
        )
    return MaterialSample(
        kind,
        length,
        width,
        height,
        stiffness=spread(800, 5000),
        yield_force=spread(0.02, 0.5),
        viscosity=spread(10, 300),
    )


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Probe the objects, and return one row for each.

    Results so far are stored in `out`/material.json.
    """
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST_SEED, FIRST_SEED + (OBJECTS_QUICK if quick else OBJECTS)):
            rows.append(_row(seed, Path(folder)))
            notify(_line(rows[-1]))
            write_json(Path(out) / "material.json", {"runs": rows, **summary(rows)})
    result = {"runs": rows, **summary(rows)}
    _plot(Path(out), rows)
    return result


def _row(seed: int, folder: Path) -> dict[str, Any]:
    sample = random_material_sample(seed)
    path = folder / f"body{seed}.xml"
    path.write_text(to_mjcf(sample, path.stem), encoding="utf-8")
    row: dict[str, Any] = {"seed": seed, "kind": sample.kind, "material_true": sample.material}
    scenario = Scenario(object=str(path), controller="probe", seed=seed)
    try:
        return row | _compare(sample, run_probe(scenario))
    except MjtactileError as error:
        return row | {"material": "fault", "error": str(error)}


def _compare(sample: MaterialSample, result: ProbeResult) -> dict[str, Any]:
    """Return the result and the ground truth in one row.

    Stiffness and modulus are those at the force of the hold.
    """
    found = result.summary()
    row = {
        key: found[key]
        for key in (
            "material",
            "probability",
            "status",
            "force_N",
            "deformation_mm",
            "stiffness_N_m",
            "modulus_kPa",
            "modulus_interval_kPa",
            "relaxation_time_s",
            "permanent_set_mm",
        )
    }
    if sample.material == "soft":
        force = row["force_N"] if math.isfinite(row["force_N"]) else 0.9
        row |= {
            "stiffness_true_N_m": sample.secant_stiffness(force),
            "modulus_true_kPa": 1e-3 * sample.modulus(force),
            "relaxation_time_true_s": sample.relaxation_time,
        }
    return row


def _line(row: Mapping[str, Any]) -> str:
    true = f"{row['modulus_true_kPa']:.0f} kPa" if "modulus_true_kPa" in row else ""
    estimated = (
        f"{row['modulus_kPa']:.0f} kPa" if math.isfinite(row.get("modulus_kPa", math.nan)) else ""
    )
    return (
        f"{row['seed']} {row['kind']} {true}: {row['material']} {estimated} "
        f"{row.get('error', row.get('status', ''))}"
    )


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Compute fractions and medians over the rows."""
    right = [row["material"] == row["material_true"] for row in rows]
    soft = [row for row in rows if row["material_true"] == "soft"]
    ratios = [
        row["modulus_kPa"] / row["modulus_true_kPa"]
        if math.isfinite(row.get("modulus_kPa", math.nan))
        else math.inf
        for row in soft
        if "modulus_true_kPa" in row
    ]
    inside = [
        row["modulus_interval_kPa"][0] <= row["modulus_true_kPa"] <= row["modulus_interval_kPa"][1]
        for row in soft
        if math.isfinite(row.get("modulus_kPa", math.nan))
    ]
    relaxed = [
        row["relaxation_time_s"] / row["relaxation_time_true_s"]
        for row in soft
        if row.get("relaxation_time_true_s", 0) > 0 and row.get("relaxation_time_s", math.nan) > 0
    ]
    stiff = [
        row["stiffness_N_m"] / row["stiffness_true_N_m"]
        for row in soft
        if row.get("stiffness_N_m", math.nan) > 0
    ]
    return {
        "bodies": len(rows),
        "class_right": float(np.mean(right)) if right else math.nan,
        "wrong_class": sum(
            row["material"] not in (row["material_true"], "unknown") for row in rows
        ),
        "unknown": sum(row["material"] == "unknown" for row in rows),
        "soft": len(soft),
        "modulus_within_2": float(np.mean([0.5 <= r <= 2 for r in ratios])) if ratios else math.nan,
        "modulus_ratio_median": statistics.median(ratios) if ratios else math.nan,
        "modulus_in_interval": float(np.mean(inside)) if inside else math.nan,
        "stiffness_ratio_median": statistics.median(stiff) if stiff else math.nan,
        "relaxation_seen": len(relaxed),
        "relaxation_ratio_median": statistics.median(relaxed) if relaxed else math.nan,
    }


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    rows = [
        ("objects (not used for tuning)", result["bodies"], "", ""),
        ("correct material class", f"{100 * result['class_right']:.0f} %", "93 %", "98 %"),
        ("wrong class / unknown", f"{result['wrong_class']} / {result['unknown']}", "", ""),
        (
            f"modulus within a factor of 2 ({result['soft']} soft objects)",
            f"{100 * result['modulus_within_2']:.0f} %",
            "85 %",
            "95 %",
        ),
        ("modulus, estimated/true, median", f"{result['modulus_ratio_median']:.2f}", "", ""),
        (
            "true modulus within the 68 % interval",
            f"{100 * result['modulus_in_interval']:.0f} %",
            "",
            "",
        ),
        ("stiffness, estimated/true, median", f"{result['stiffness_ratio_median']:.2f}", "", ""),
        (
            f"relaxation time, estimated/true, median ({result['relaxation_seen']} objects)",
            f"{result['relaxation_ratio_median']:.2f}",
            "",
            "",
        ),
    ]
    lines = ["| quantity | measured | required | target |", "|---|---|---|---|"]
    return "\n".join([*lines, *(f"| {a} | {b} | {c} | {d} |" for a, b, c, d in rows)]) + "\n"


def _plot(out: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Plot estimated against true modulus in `material.png`."""
    if (figure := new_figure("material.png", (5.6, 4.6))) is None:
        return
    axes = figure.add_subplot()
    for kind, mark in (("elastic", "o"), ("viscoelastic", "s")):
        group = [
            r for r in rows if r["kind"] == kind and math.isfinite(r.get("modulus_kPa", math.nan))
        ]
        axes.plot(
            [r["modulus_true_kPa"] for r in group],
            [r["modulus_kPa"] for r in group],
            mark,
            ms=5,
            label=kind,
        )
    line = np.array([5.0, 1000.0])
    axes.plot(line, line, "k-", lw=1)
    for factor in (0.5, 2.0):
        axes.plot(line, factor * line, "k:", lw=1)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="true modulus at the probing force, kPa",
        ylabel="estimated, kPa",
    )
    axes.legend()
    figure.savefig(out / "material.png")
