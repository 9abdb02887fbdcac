"""`mjtactile bench fit`: identified parameters of sensors that differ from their nominal file.

The sensors are recorded on the simulated stage, fitted, and compared with ground truth. Other seeds
were used to develop the fit. The true parameters are used only here: the recordings name the
nominal file. One sensor is recorded with a finer membrane than that of the fit. Otherwise the same
mesh on both sides would hide the discretization error. The lenses of two differ from the file.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.toml import read_json
from mjtactile.experiments.motion_stage import NOTHING, record_stage
from mjtactile.fit.identification import FitOptions, fit_recordings
from mjtactile.fit.result import FitResult
from mjtactile.recording.files import write_json
from mjtactile.recording.stage_protocol import Stage, read_moves
from mjtactile.recording.writer import Recorder
from mjtactile.report.figures import new_figure
from mjtactile.runtime.progress import Progress
from mjtactile.sim.attach import DEFAULT_MESH

FINE_MESH = (17, 13)


@dataclass(frozen=True)
class AsBuilt:
    """Sensor that differs from its file.

    `seed` determines its parameters, `mesh` its simulation (None: the default). `lens` is its focal
    length relative to the file.
    """

    seed: int
    mesh: tuple[int, int] | None = None
    lens: float = 1.0

    @property
    def label(self) -> str:
        mesh = "" if self.mesh is None else f", {self.mesh[0]} x {self.mesh[1]} vertices"
        lens = "" if self.lens == 1 else f", lens {100 * (self.lens - 1):+.0f} %"
        return f"seed {self.seed}{mesh}{lens}"


AS_BUILT = (
    AsBuilt(701),
    AsBuilt(702, lens=1.02),
    AsBuilt(703),
    AsBuilt(704, lens=0.98),
    AsBuilt(705, FINE_MESH),
    AsBuilt(706),
    AsBuilt(707),
    AsBuilt(708),
)
DIFFERS = 0.3  # maximum relative deviation of each parameter
AIR = {"polytropic_exponent": 1.4, "thermal_time_constant_s": 1.0, "leak_mL_s_kPa": 0.01}
"""Gas parameters of the nominal file in addition to those of `dense`."""
FORCE_REQUESTED = 0.02
FRACTION_REQUESTED = 0.05
FRACTION_ALLOWED = 0.03
FITTED = (
    ("press_05", "press", "sphere:8", 500.0, 9.0),
    ("press_3", "press", "sphere:8", 3000.0, 9.0),
    ("drag", "drag", "sphere:8", 1000.0, 10.0),
    ("tap", "tap", "sphere:13.5", 1000.0, 13.0),
    ("still", None, "", 2000.0, 12.0),
)
HELD_OUT = ("other", "press", "sphere:12", 1500.0, 9.0)
"""Name, protocol, indenter, Pa and s of each recording."""


def nominal_text() -> str:
    """Return the nominal sensor file, the start of the fit."""
    from mjtactile.core import resources

    text = resources.find("dense", "models/sensors", ".toml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("polytropic_exponent")]
    place = lines.index("[chamber]") + 1
    return (
        "\n".join(
            [*lines[:place], *(f"{key} = {value}" for key, value in AIR.items()), *lines[place:]]
        )
        + "\n"
    )


def random_sample(nominal: SensorDesign, seed: int) -> SensorDesign:
    """Return the design with each parameter changed by up to the fraction DIFFERS.

    Thickness and modulus are changed independently.
    """
    rng = np.random.default_rng(seed)

    def off(value: float) -> float:
        return value * (1 + float(rng.uniform(-DIFFERS, DIFFERS)))

    rubber = nominal.membrane
    chamber = nominal.chamber
    camera = nominal.camera
    leds = nominal.leds
    rubber = replace(
        rubber,
        young=off(rubber.young),
        thickness=off(rubber.thickness),
        friction=off(rubber.friction),
        pre_stretch=1 + off(rubber.pre_stretch - 1),
    )
    chamber = replace(
        chamber,
        extra_volume=off(nominal.chamber_volume_flat) - nominal.chamber_volume_flat,
        leak_conductance=off(chamber.leak_conductance),
        heat_exchange=off(chamber.heat_exchange),
    )
    camera = replace(camera, blur_px=off(camera.blur_px), noise_dn=off(camera.noise_dn))
    leds = replace(
        leds,
        membrane_dn=min(off(leds.membrane_dn), 235.0),
        marker_dn=off(leds.marker_dn),
        vignetting=off(leds.vignetting),
    )
    return replace(nominal, membrane=rubber, chamber=chamber, camera=camera, leds=leds)


def run(
    out: Path,
    *,
    quick: bool = False,
    resume: bool = False,
    notify: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Record and fit the sensors.

    Args:
        out: Folder; results so far are stored in its fit.json.
        quick: The first sensor only.
        resume: Continue with the stored results.
        notify: Receiver of a message for every step; None: the terminal.

    Returns:
        "specimens", a row for each sensor.
    """
    notify = Progress().message if notify is None else notify
    kept = Path(out) / "fit.json"
    stored = list(read_json(kept)["specimens"]) if resume and kept.exists() else []
    rows = [row for row in stored if row["label"] in {item.label for item in AS_BUILT}]
    for as_built in AS_BUILT[:1] if quick else AS_BUILT:
        if as_built.label in {row["label"] for row in rows}:
            continue
        with tempfile.TemporaryDirectory() as folder:
            rows.append(_row(Path(folder), as_built, notify))
        write_json(kept, {"specimens": rows})
        notify(
            f"{as_built.label}: worst number "
            f"{100 * max(abs(n['error']) for n in rows[-1]['numbers'] if n['is_fitted']):.1f} % "
            f"off, worst force {1e3 * max(abs(f['error_N']) for f in rows[-1]['forces']):.1f} mN"
        )
    _plot(Path(out), rows)
    return {"specimens": rows}


def _row(folder: Path, as_built: AsBuilt, notify: Callable[[str], None]) -> dict[str, Any]:
    (folder / "nominal.toml").write_text(nominal_text(), encoding="utf-8")
    nominal = load_sensor(folder / "nominal.toml")
    true = random_sample(nominal, as_built.seed)
    focal = {name: as_built.lens * getattr(true.camera, name) for name in ("fx", "fy")}
    true = replace(true, camera=replace(true.camera, **focal))
    for number, recording in enumerate((*FITTED, HELD_OUT)):
        _record(folder, true, recording, 1000 * as_built.seed + number, as_built.mesh)
    notify(f"{as_built.label}: recorded")
    wall = time.monotonic()
    core = time.process_time()
    result = fit_recordings(
        [folder / name for name, *_ in FITTED],
        sensor=folder / "nominal.toml",
        held_out=[folder / HELD_OUT[0]],
        options=FitOptions(notify=notify),
    )
    forces = [
        {
            "depth_mm": 1e3 * h.depth,
            "predicted_N": h.force,
            "load_cell_N": h.force_measured,
            "error_N": h.force - h.force_measured,
        }
        for h in result.held_out
        if not math.isnan(h.depth)
    ]
    return {
        "label": as_built.label,
        "seconds": time.monotonic() - wall,
        "core_s": time.process_time() - core,
        "numbers": scores(result, nominal, true),
        "forces": forces,
        "correlations": result.correlations,
        "lens": result.lens,
        "height_error": result.membrane.heights,
        "lens_true": as_built.lens,
    }


def _record(
    folder: Path,
    true: SensorDesign,
    recording: tuple[str, str | None, str, float, float],
    seed: int,
    mesh: tuple[int, int] | None,
) -> None:
    name, protocol, indenter, pressure, seconds = recording
    stage = NOTHING if protocol is None else Stage(indenter, (0.0, 0.0), read_moves(protocol))
    design = replace(true, chamber=replace(true.chamber, supply_gauge=pressure))
    header = {"sensor": "dense", "rig": "stage", "design": "nominal", "seed": seed}
    with Recorder(folder / name / "recording", header) as recorder:
        record_stage(
            design,
            stage,
            recorder,
            seconds=seconds,
            seed=seed,
            load_cell=name == HELD_OUT[0],
            mesh=mesh or DEFAULT_MESH,
        )


def scores(result: FitResult, nominal: SensorDesign, true: SensorDesign) -> list[dict[str, Any]]:
    """Return true value, estimate and relative error of each parameter.

    Thickness times modulus is one parameter. Pre-stretch counts less 1. Gas volume counts in full,
    behind the flat membrane.
    """
    found = result.design
    flat = nominal.chamber_volume_flat - nominal.chamber.extra_volume
    rubber = found.membrane
    volume = found.chamber_volume_flat
    rows = [
        (
            "modulus times thickness, N/m",
            "membrane.young_MPa",
            true.membrane.young * true.membrane.thickness,
            rubber.young * rubber.thickness,
            1e6 * rubber.thickness,
        ),
        (
            "pre-stretch minus 1",
            "membrane.pre_stretch",
            true.membrane.pre_stretch - 1,
            rubber.pre_stretch - 1,
            1.0,
        ),
        ("friction", "membrane.friction", true.membrane.friction, rubber.friction, 1.0),
        (
            "gas volume, mL",
            "chamber.extra_volume_mL",
            1e6 * (flat + true.chamber.extra_volume),
            1e6 * volume,
            1.0,
        ),
        (
            "leak, mL/(s kPa)",
            "chamber.leak_mL_s_kPa",
            1e9 * true.chamber.leak_conductance,
            1e9 * found.chamber.leak_conductance,
            1.0,
        ),
        (
            "polytropic exponent minus 1",
            "chamber.polytropic_exponent",
            true.chamber.polytropic_exponent - 1,
            found.chamber.polytropic_exponent - 1,
            1.0,
        ),
        (
            "thermal time constant, s",
            "chamber.thermal_time_constant_s",
            true.chamber.heat_exchange,
            found.chamber.heat_exchange,
            1.0,
        ),
        ("blur, px", "camera.blur_px", true.camera.blur_px, found.camera.blur_px, 1.0),
        ("noise, DN", "camera.noise_DN", true.camera.noise_dn, found.camera.noise_dn, 1.0),
        ("membrane, DN", "leds.membrane_DN", true.leds.membrane_dn, found.leds.membrane_dn, 1.0),
        ("markers, DN", "leds.marker_DN", true.leds.marker_dn, found.leds.marker_dn, 1.0),
        ("vignetting", "leds.vignetting", true.leds.vignetting, found.leds.vignetting, 1.0),
    ]
    return [
        {
            "quantity": quantity,
            "true": t,
            "found": f,
            "error": f / t - 1,
            "sd": result.parameter(field).sd * scale / t,
            "is_fitted": result.parameter(field).state == "fitted",
        }
        for quantity, field, t, f, scale in rows
    ]


def table(result: Mapping[str, Any]) -> str:
    """Format the errors of each quantity in Markdown, sensor by sensor."""
    rows = result["specimens"]
    names = "; ".join(row["label"] for row in rows)
    lines = [
        f"Order of the sensors: {names}.",
        "",
        "| quantity | required | error, % if not stated (half of the 95 % interval, median) |",
        "|---|---|---|",
    ]
    for i, number in enumerate(rows[0]["numbers"]):
        errors = _errors([row["numbers"][i] for row in rows])
        lines.append(f"| {number['quantity']} | {100 * FRACTION_REQUESTED:g} | {errors} |")
    worst = [f"{1e3 * max(abs(f['error_N']) for f in row['forces']):.1f}" for row in rows]
    loads = [max(f["load_cell_N"] for f in row["forces"]) for row in rows]
    lines.append(
        f"| held-out loads of {min(loads):.2f} to {max(loads):.2f} N, largest error, mN | "
        f"{1e3 * FORCE_REQUESTED:g} | {', '.join(worst)} |"
    )
    heights = [row["height_error"] for row in rows]
    lens = ", ".join(f"{-100 * error:+.1f}" for error, _ in heights)
    interval = median(196 * sd for _, sd in heights)
    lines.append(f"| focal length relative to the file | | {lens} (±{interval:.1f}) |")
    times = [f"{row['core_s']:.0f}" for row in rows]
    lines.append(f"| core time, s | 600 | {', '.join(times)} |")
    fitted = [n for row in rows for n in row["numbers"] if n["is_fitted"] and n["sd"] > 0]
    inside = sum(abs(n["error"]) <= 2 * n["sd"] for n in fitted)
    within = sum(abs(n["error"]) <= FRACTION_ALLOWED for n in fitted)
    lines += [
        "",
        f"Of {len(fitted)} fitted values, {inside} are within two sd of ground truth "
        f"({100 * inside / len(fitted):.0f} %), and {within} within "
        f"{100 * FRACTION_ALLOWED:g} % ({100 * within / len(fitted):.0f} %).",
    ]
    return "\n".join(lines) + "\n"


def _errors(numbers: Sequence[Mapping[str, Any]]) -> str:
    """Format the errors of one quantity; "-": not fitted."""
    errors = [f"{100 * n['error']:+.1f}" if n["is_fitted"] else "-" for n in numbers]
    intervals = [196 * n["sd"] for n in numbers if n["is_fitted"]]
    return ", ".join(errors) + (f" (±{median(intervals):.1f})" if intervals else "")


def _plot(out: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Plot the error of each parameter with its interval, and the forces kept aside, in
    `fit.png`."""
    if (figure := new_figure("fit.png", (10.0, 4.6))) is None:
        return
    left, right = figure.subplots(1, 2, width_ratios=[2, 1])
    names = [number["quantity"] for number in rows[0]["numbers"]]
    for k, row in enumerate(rows):
        label = row["label"]
        shown = [(i, n) for i, n in enumerate(row["numbers"]) if n["is_fitted"]]
        left.errorbar(
            [100 * n["error"] for _, n in shown],
            [i + 0.15 * k for i, _ in shown],
            xerr=[196 * n["sd"] for _, n in shown],
            fmt="o",
            ms=4,
            capsize=2,
            label=label,
        )
        forces = row["forces"]
        right.plot(
            [f["load_cell_N"] for f in forces],
            [1e3 * f["error_N"] for f in forces],
            "o-",
            ms=4,
            label=label,
        )
    left.set_yticks(range(len(names)), names, fontsize=8)
    left.axvspan(-100 * FRACTION_REQUESTED, 100 * FRACTION_REQUESTED, color="k", alpha=0.07)
    left.set(xlabel="error, %, with 95 % interval", xlim=(-12, 12))
    right.axhspan(-1e3 * FORCE_REQUESTED, 1e3 * FORCE_REQUESTED, color="k", alpha=0.07)
    right.set(xlabel="force in the held-out load, N", ylabel="predicted minus load cell, mN")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    figure.savefig(out / "fit.png")
