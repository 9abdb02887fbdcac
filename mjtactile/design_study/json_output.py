"""JSON output of `mjtactile design`: performance of a file, or files that meet requirements."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, MjtactileError
from mjtactile.design_study import predict_file, sensor_file_edit
from mjtactile.design_study.buildability import check_by_simulation
from mjtactile.design_study.design_sweep import (
    INTERRUPTED,
    DesignCandidate,
    Requirements,
    best,
    sweep,
)
from mjtactile.design_study.given_hardware import ALL_FREE, GivenHardware
from mjtactile.design_study.plots import number
from mjtactile.design_study.prediction_check import check, check_range, verdict
from mjtactile.design_study.score import MIN_TOUCH, largest_force, score
from mjtactile.design_study.virtual_bench import VirtualBench

_WRITTEN = 3

Notify = Callable[[str], None]


def of_file(
    design: SensorDesign, force: float, *, check: int = 0, seed: int = 0, notify: Notify
) -> dict[str, Any]:
    """Predict the performance at a `force`, N; `check`: positions checked in full simulation."""
    result = predict_file.as_table(predict_file.study(design, force, notify=notify))
    if check:
        result["checked"] = [_checked(design, check, seed, notify)]
    return result


def from_requirements(
    design: SensorDesign,
    force: float,
    requirements: Requirements,
    *,
    given: GivenHardware = ALL_FREE,
    count: int,
    check: int = 0,
    seed: int = 0,
    notify: Notify,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Search for files that meet the requirements.

    Args:
        design: Initial design.
        force: Indenting force, N.
        requirements: Requirements.
        given: Parts of the camera that stay as they are.
        count: Number of sampled designs.
        check: Number of the best designs that are checked in full simulation.
        seed: Seed of samples and indentations.
        notify: Called with progress messages.

    Returns:
        The JSON's object, and the best sensors' files by name. After an interruption they are those
        of the completed part, and "stopped" is the reason.
    """
    notify(f"performance of {design.name}")
    initial = _initial(design, force, requirements)
    sampled, stopped = sweep(
        design, force, requirements, given=given, count=count, seed=seed, notify=notify
    )
    notify("checking the best designs as `mjtactile fabricate` does")
    picked, candidates = best(sampled, max(_WRITTEN, check), check_by_simulation, notify)
    named = {f"best_{number}": candidate for number, candidate in enumerate(picked, 1)}
    chosen = [replace(candidate.design, name=name) for name, candidate in named.items()]
    checked, interrupted = _until_interrupted(chosen[: 0 if stopped else check], seed, notify)
    texts = {f"{name}.toml": _text(name, candidate, force) for name, candidate in named.items()}
    result = {
        "sensor": design.name,
        "force_N": force,
        "requirements": {
            "detect_force_mN": None if requirements.touch is None else 1e3 * requirements.touch,
            "range_N": requirements.maximum,
            "edge_mm": None if requirements.edge is None else 1e3 * requirements.edge,
            "radius_mm": None if requirements.radius is None else 1e3 * requirements.radius,
        },
        "requirement_table": requirement_rows(requirements, candidates),
        "refused_by_fabricate": len(sampled) - len(candidates),
        "initial": initial,
        "candidates": [_row(candidate) for candidate in candidates],
        "best": [{"file": f"{name}.toml"} | _row(candidate) for name, candidate in named.items()],
        "checked": checked,
        "stopped": stopped or interrupted,
    }
    return result, texts


def _until_interrupted(
    designs: Sequence[SensorDesign], seed: int, notify: Notify
) -> tuple[list[dict[str, Any]], str | None]:
    """Check designs in full simulation; return the completed checks, and "interrupted" or None."""
    checked = []
    try:
        for design in designs:
            checked.append(_checked(design, 4, seed, notify))
    except KeyboardInterrupt:
        return checked, INTERRUPTED
    return checked, None


def _initial(design: SensorDesign, force: float, requirements: Requirements) -> dict[str, Any]:
    """Return the performance of the initial file, and the reason if it cannot be used."""
    try:
        reached = score(sensor_file_edit.rebuilt(design), force)
    except (InputError, MjtactileError) as error:
        return {"performance": None, "missed": None, "why_not": str(error)}
    return {"performance": reached.table(), "missed": requirements.missed(reached), "why_not": ""}


def requirement_rows(
    requirements: Requirements, candidates: Sequence[DesignCandidate]
) -> list[dict[str, Any]]:
    """Return each requirement with the limit of the sensing pipeline and the designs that meet it.

    Args:
        requirements: Requirements.
        candidates: Sampled designs.

    Returns:
        Rows: requirement, required value, limit (null: none), number of designs that meet it; for
        the detection threshold also those that would by pixel noise alone.
    """
    rows = []
    for name, key, value, scale, limit in (
        ("touch", "detect_force_mN", requirements.touch, 1e3, 1e3 * MIN_TOUCH),
        ("range", "range_N", requirements.maximum, 1.0, None),
        ("edge", "edge_mm", requirements.edge, 1e3, None),
        ("radius", "radius_mm", requirements.radius, 1e3, None),
    ):
        if value is None:
            continue
        row: dict[str, Any] = {"requirement": key, "required": scale * value, "limit": limit}
        row["met"] = sum(name not in candidate.missed for candidate in candidates)
        row["of"] = len(candidates)
        if name == "touch":
            row["met_by_noise"] = sum(candidate.score.seen <= value for candidate in candidates)
        rows.append(row)
    return rows


def _row(candidate: DesignCandidate) -> dict[str, Any]:
    design = candidate.design
    return {
        "performance": candidate.score.table(),
        "missed": list(candidate.missed),
        "meets": not candidate.missed,
        "on_front": candidate.on_front,
        "rows": design.markers.rows,
        "columns": design.markers.columns,
        "marker_radius_mm": 1e3 * design.markers.radius,
        "fx_px": design.camera.fx,
        "camera_distance_mm": 1e3 * design.camera.distance,
        "chamber_depth_mm": 1e3 * design.chamber.depth,
        "thickness_mm": 1e3 * design.membrane.thickness,
        "pre_stretch": design.membrane.pre_stretch,
        "supply_pressure_kPa": 1e-3 * design.chamber.supply_gauge,
    }


def _text(name: str, candidate: DesignCandidate, force: float) -> str:
    reached = candidate.score.table()
    head = (
        f"Written by `mjtactile design`. Predicted at {force:g} N: force sd "
        f"{number(reached['force_sd_mN'])} mN,\n"
        f"edge position sd {number(reached['edge_sd_mm'])} mm; detection threshold "
        f"{number(reached['detection_mN'])} mN, largest force {number(reached['force_max_N'])} N."
    )
    return sensor_file_edit.sensor_text(replace(candidate.design, name=name), head)


def _checked(design: SensorDesign, positions: int, seed: int, notify: Notify) -> dict[str, Any]:
    """Compare the predicted sd with the scatter of indentations in full simulation."""
    notify(f"indenting {design.name} in full simulation")
    claimed = largest_force(VirtualBench(design))
    checked = check_range(design, claimed, seed=seed) if math.isfinite(claimed) else None
    presses = check(design, positions=positions, seed=seed, notify=notify)
    found = {} if not presses else asdict(verdict(presses))
    return {
        "sensor": design.name,
        "presses": len(presses),
        "force_ratio": found.get("force_ratio"),
        "place_ratio": found.get("place_ratio"),
        "force_error_rms_mN": 1e3 * found["force_rms"] if found else None,
        "place_error_rms_mm": 1e3 * found["place_rms"] if found else None,
        "range": None
        if checked is None
        else asdict(checked) | {"is_confirmed": checked.is_confirmed},
    }
