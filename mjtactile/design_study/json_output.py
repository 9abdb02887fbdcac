"""JSON output of `mjtactile design`: performance of a file, or files that meet requirements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

from mjtactile.core.design import SensorDesign
from mjtactile.design_study import predict_file, sensor_file_edit
from mjtactile.design_study.design_sweep import DesignCandidate, Requirements, best, sweep
from mjtactile.design_study.prediction_check import check, verdict
from mjtactile.design_study.score import score

_WRITTEN = 3

Say = Callable[[str], None]


def of_file(
    design: SensorDesign, force: float, *, check: int = 0, seed: int = 0, say: Say
) -> dict[str, Any]:
    """Predict the performance at a `force`, N; `check`: positions checked in full simulation."""
    result = predict_file.as_table(predict_file.study(design, force, say=say))
    if check:
        result["checked"] = [_checked(design, check, seed, say)]
    return result


def from_requirements(
    design: SensorDesign,
    force: float,
    requirements: Requirements,
    *,
    count: int,
    check: int = 0,
    seed: int = 0,
    say: Say,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Search for files that meet the requirements.

    Args:
        design: Initial design.
        force: Indenting force, N.
        requirements: Requirements.
        count: Number of sampled designs.
        check: Number of the best designs that are checked in full simulation.
        seed: Seed of samples and indentations.
        say: Called with progress messages.

    Returns:
        The JSON's object, and the best sensors' files by name.
    """
    say(f"what {design.name} reaches")
    initial = score(design, force)
    candidates = sweep(design, force, requirements, count=count, seed=seed, say=say)
    picked = best(candidates, max(_WRITTEN, check))
    named = {f"best_{number}": one for number, one in enumerate(picked, 1)}
    texts = {f"{name}.toml": _text(name, one, force) for name, one in named.items()}
    result = {
        "sensor": design.name,
        "force_N": force,
        "requirements": {
            "detect_force_mN": None if requirements.touch is None else 1e3 * requirements.touch,
            "range_N": requirements.maximum,
            "edge_mm": None if requirements.edge is None else 1e3 * requirements.edge,
            "radius_mm": None if requirements.radius is None else 1e3 * requirements.radius,
        },
        "initial": {"reaches": initial.table(), "missed": requirements.missed(initial)},
        "candidates": [_row(one) for one in candidates],
        "best": [{"file": f"{name}.toml"} | _row(one) for name, one in named.items()],
        "checked": [
            _checked(replace(one.design, name=name), 4, seed, say)
            for name, one in list(named.items())[:check]
        ],
    }
    return result, texts


def _row(one: DesignCandidate) -> dict[str, Any]:
    design = one.design
    return {
        "reaches": one.score.table(),
        "missed": list(one.missed),
        "meets": not one.missed,
        "on_front": one.on_front,
        "rows": design.markers.rows,
        "columns": design.markers.columns,
        "marker_radius_mm": 1e3 * design.markers.radius,
        "fx_px": design.camera.fx,
        "thickness_mm": 1e3 * design.membrane.thickness,
        "pre_stretch": design.membrane.pre_stretch,
        "supply_pressure_kPa": 1e-3 * design.chamber.supply_gauge,
    }


def _text(name: str, one: DesignCandidate, force: float) -> str:
    reached = one.score.table()
    head = (
        f"Written by `mjtactile design`. Predicted at {force:g} N: force sd "
        f"{reached['force_sd_mN']:.1f} mN,\n"
        f"edge position sd {reached['edge_sd_mm']:.3f} mm; touch threshold from noise "
        f"{reached['touch_by_noise_mN']:.1f} mN, largest force {reached['force_max_N']:.1f} "
        "N."
    )
    return sensor_file_edit.sensor_text(replace(one.design, name=name), head)


def _checked(design: SensorDesign, places: int, seed: int, say: Say) -> dict[str, Any]:
    """Compare the predicted sd with the scatter of indentations in full simulation."""
    say(f"indenting {design.name} in full simulation")
    presses = check(design, places=places, seed=seed, say=say)
    found = {} if not presses else asdict(verdict(presses))
    return {
        "sensor": design.name,
        "presses": len(presses),
        "force_ratio": found.get("force_ratio"),
        "place_ratio": found.get("place_ratio"),
        "force_error_rms_mN": 1e3 * found["force_rms"] if found else None,
        "place_error_rms_mm": 1e3 * found["place_rms"] if found else None,
    }
