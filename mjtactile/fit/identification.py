"""Identification of a sensor file from recordings: fit membrane, gas and images, then validate on
held-out recordings."""

from __future__ import annotations

import math
import time as wall
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import resources
from mjtactile.core.design import SensorDesign, load_sensor, sensor_from_table
from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import Chamber
from mjtactile.core.types import Array
from mjtactile.fit.gas import GasFit, Sealed, fit_gas, predict, sealed_runs
from mjtactile.fit.image_noise import fit_image_noise
from mjtactile.fit.measurements import Evidence, read_evidence
from mjtactile.fit.membrane_fit import DEFAULT, FitOptions, MembraneFit, fit_membrane
from mjtactile.fit.parameter_info import ABOUT, GAS_FRACTION, correlations
from mjtactile.fit.result import FIELD, SI, FitResult, HeldOut, covariance_of, fitted_parameters
from mjtactile.fit.rewrite_sensor_file import rewrite
from mjtactile.fit.sealed_replay import (
    MembraneErrors,
    ReplayedRecording,
    can_replay,
    linear_model,
    membrane_errors,
    touches,
)
from mjtactile.fit.simulated_holds import simulate
from mjtactile.recording.reader import load_recording
from mjtactile.sim.attach import default_mesh

# order in which undetermined parameters are fixed: those closest to their design value first
_HEAT = ("heat_exchange", "polytropic_exponent")
_LENS_ROUNDS = 2  # further membrane fits, each with the lens of the last
_ROUNDS = 3  # rounds of the gas fit, each with replays at the last result
# limit of the change of a recording's pressures by a round, rms, Pa: their linear model is accurate
# to a tenth of it
_LINEAR = 10.0
_HELD_FIRST = ("friction", "pre_stretch", "young")


def fit_recordings(
    recordings: Sequence[Path],
    *,
    sensor: Path | None = None,
    known: Mapping[str, float] | None = None,
    held_out: Sequence[Path] = (),
    options: FitOptions = DEFAULT,
) -> FitResult:
    """Fit the sensor of `recordings`, starting from their own sensor file or from `sensor`.

    `known` contains manually measured values, by field of the sensor file in its unit. Recordings
    of `held_out` are predicted only. Raises InputError for input that cannot be used.
    """
    start = wall.monotonic()
    known = dict(known or {})
    text, nominal = _sensor(recordings, sensor)
    design, manually = _with_fixed_values(nominal, known)
    free, membrane, evidence = _fit_lens(recordings, design, manually["membrane"], options)
    seen = _with_lens(design, membrane.focal_scale)
    image = fit_image_noise(seen, evidence[0].flat)
    gas = _gas(membrane, evidence, manually["chamber"], options)
    parameters = tuple(fitted_parameters(nominal, known, evidence, membrane, gas, image))
    names, cov = covariance_of(free, gas, "membrane.thickness_mm" in known)
    sentences = correlations(
        names, cov, {parameter.field: parameter.state for parameter in parameters}
    )
    found = rewrite(
        text, parameters, f"Fitted by `mjtactile fit` to {', '.join(e.name for e in evidence)}."
    )
    fitted = sensor_from_table(tomllib.loads(found), name=options.name, source=options.name)
    checks = tuple(
        check
        for path in held_out
        for check in _check(
            fitted, read_evidence(path, seen, options.finger, options.notify), options.mesh
        )
    )
    return FitResult(
        fitted,
        found,
        parameters,
        tuple(sentences),
        tuple(evidence),
        membrane,
        gas,
        image,
        checks,
        wall.monotonic() - start,
    )


def _sensor(recordings: Sequence[Path], sensor: Path | None) -> tuple[str, SensorDesign]:
    """Return text and design of the initial sensor file."""
    if sensor is not None:
        path = resources.find(sensor, "models/sensors", ".toml")
        return path.read_text(encoding="utf-8-sig"), load_sensor(path)
    files = [load_recording(path).header.get("files", {}).get("sensor") for path in recordings]
    if files[0] is None or any(file is None or file["text"] != files[0]["text"] for file in files):
        message = "the recordings do not name a common sensor file; specify the initial one"
        raise InputError(message, field="--sensor")
    text = files[0]["text"]
    return text, sensor_from_table(
        tomllib.loads(text), name=Path(files[0]["name"]).stem, source=files[0]["name"]
    )


def _with_lens(design: SensorDesign, scale: float) -> SensorDesign:
    """Return the design with focal lengths times a scale: the light falls off with the angle."""
    camera = design.camera
    return replace(design, camera=replace(camera, fx=scale * camera.fx, fy=scale * camera.fy))


def _with_fixed_values(
    design: SensorDesign, known: Mapping[str, float]
) -> tuple[SensorDesign, dict[str, dict[str, float]]]:
    """Return the design with the known values, and these by section and attribute, SI."""
    by_section: dict[str, dict[str, float]] = {section: {} for section, *_ in SI.values()}
    for field, value in known.items():
        if field not in SI:
            raise InputError(
                f"{field!r} is not a field of a sensor file", field="--fix", choices=sorted(SI)
            )
        section, attribute, scale = SI[field]
        by_section[section][attribute] = value * scale
    parts = {
        section: replace(getattr(design, section), **values)
        for section, values in by_section.items()
        if values
    }
    return replace(design, **parts), by_section


def _fit_lens(
    recordings: Sequence[Path],
    design: SensorDesign,
    known: Mapping[str, float],
    options: FitOptions,
) -> tuple[MembraneFit, MembraneFit, list[Evidence]]:
    """Fit the membrane, and again with the lens that the recordings show.

    A wrong focal length scales the heights of level markers. Those of inclined ones differ from it
    by some 0.05 mm, so that the images are evaluated again with the lens found.

    Args:
        recordings: Folders.
        design: Sensor with the lens of the file.
        known: Known values of the membrane by name, SI.
        options: Options of the fit.

    Returns:
        The two fits of `_fit_membrane`, with `heights` relative to the file's lens, and the
        measurements.
    """
    evidence = [read_evidence(path, design, options.finger, options.notify) for path in recordings]
    fractions = [e.height_fraction for e in evidence]
    free, membrane = _fit_membrane(design, evidence, known, options)
    scale = 1.0
    for _ in range(_LENS_ROUNDS):
        if membrane.focal_scale == 1:
            break
        scale *= membrane.focal_scale
        options.notify(f"lens: focal lengths times {scale:.4f}; the images are evaluated again")
        seen = _with_lens(design, scale)
        evidence = [
            replace(
                read_evidence(path, seen, options.finger, options.notify), height_fraction=fraction
            )
            for path, fraction in zip(recordings, fractions, strict=True)
        ]
        free, membrane = _fit_membrane(seen, evidence, known, options, membrane.values)
    free, membrane = (
        replace(fit, heights=((1 + fit.heights[0]) / scale - 1, fit.heights[1]))
        for fit in (free, membrane)
    )
    return free, membrane, evidence


def _fit_membrane(
    design: SensorDesign,
    evidence: Sequence[Evidence],
    known: Mapping[str, float],
    options: FitOptions,
    start: Mapping[str, float] | None = None,
) -> tuple[MembraneFit, MembraneFit]:
    """Return two membrane fits: all unknown parameters free, and undetermined ones fixed.

    A fixed parameter has the file's value. The second fit makes correlated parameters consistent
    with it. `start` contains values near the solution.
    """
    free = membrane = fit_membrane(design, evidence, known=known, options=options, start=start)
    held = dict(known)
    while name := _first_undetermined(
        membrane.names, membrane.values, membrane.cov, "membrane", _HELD_FIRST
    ):
        held[name] = getattr(design.membrane, name)
        options.notify(
            f"membrane: the recordings do not determine {name}; it keeps the file's value"
        )
        membrane = fit_membrane(design, evidence, known=held, options=options)
    return free, membrane


def _first_undetermined(
    names: Sequence[str],
    values: Mapping[str, float],
    cov: Array,
    section: str,
    order: Sequence[str],
) -> str | None:
    """Return the first fitted parameter of `order` that is not determined accurately enough."""
    for name in filter(values.__contains__, order):
        field = FIELD[section, name]
        sd = math.sqrt(cov[names.index(name)][names.index(name)])
        if not ABOUT[field].is_finite_value(values[name] / SI[field][2], sd / SI[field][2]):
            return name
    return None


def _gas(
    membrane: MembraneFit,
    evidence: Sequence[Evidence],
    known: Mapping[str, float],
    options: FitOptions,
) -> GasFit | None:
    """Fit the gas parameters in two stages.

    The first uses the volumes estimated from the markers. The second simulates the recorded
    indentations over time. Then a contact that cannot be simulated is left out: the errors of its
    volume are not known.
    """
    with_pressure = [
        i for i, e in enumerate(evidence) if e.has_pressure and np.isfinite(e.series.pressure).all()
    ]
    holds = [membrane.holds[i] for i in with_pressure]
    runs = sealed_runs([evidence[i] for i in with_pressure], holds)
    if not runs:
        return None
    found, _ = _fit_determined(membrane.design, runs, known)
    options.notify(_report_gas(found))
    recordings = {
        run: ReplayedRecording(
            evidence[i], membrane.offsets[i], options.mesh or default_mesh(membrane.design)
        )
        for run, i in zip(runs, with_pressure, strict=True)
        if can_replay(evidence[i])
    }
    if not recordings:
        return found
    used = [
        run
        for run, i in zip(runs, with_pressure, strict=True)
        if run in recordings or not touches(evidence[i])
    ]
    found, held = _fit_replayed(membrane, recordings, used, found, known)
    options.notify(_report_gas(found))
    for name in held.keys() - known.keys():
        options.notify(f"gas: the recordings do not determine {name}; it keeps the file's value")
    return found


def _fit_replayed(
    membrane: MembraneFit,
    recordings: Mapping[Sealed, ReplayedRecording],
    runs: Sequence[Sealed],
    found: GasFit,
    known: Mapping[str, float],
) -> tuple[GasFit, dict[str, float]]:
    """Fit the gas to replayed recordings, and again from the result.

    Args:
        membrane: Result of the membrane fit.
        recordings: Replayed recordings of some runs.
        runs: All runs; the others are predicted from their volumes.
        found: Start.
        known: Known values by name, SI.

    Returns:
        The fit, and the known and held values by name.
    """
    held = dict(known)
    compliances: list[Array] = []
    errors = MembraneErrors([], [])
    for _ in range(_ROUNDS):
        design = _with_gas(membrane.design, found)
        base = [recording.replay(design) for recording in recordings.values()]
        if not compliances:
            compliances = [
                recording.compliance(design, before)
                for recording, before in zip(recordings.values(), base, strict=True)
            ]
            errors = membrane_errors(design, list(recordings.values()), base, membrane)
        models = {
            run: linear_model(design, before, compliance, shift)
            for run, before, compliance, shift in zip(
                recordings, base, compliances, errors.shift, strict=True
            )
        }
        modes = [
            [dict(zip(recordings, mode, strict=True)).get(run, 0 * run.time) for run in runs]
            for mode in errors.modes
        ]
        found, held = _fit_determined(
            design,
            runs,
            known,
            membrane.design.chamber,
            models=[models.get(run, predict) for run in runs],
            modes=modes,
        )
        changed = _with_gas(membrane.design, found)
        moved = [models[run](changed, run) - models[run](design, run) for run in recordings]
        if max(float(np.sqrt(np.mean(change**2))) for change in moved) < _LINEAR:
            break
    return found, held


def _with_gas(design: SensorDesign, found: GasFit) -> SensorDesign:
    return replace(design, chamber=replace(design.chamber, **found.values))


def _fit_determined(
    design: SensorDesign,
    runs: Sequence[Sealed],
    known: Mapping[str, float],
    file_values: Chamber | None = None,
    **options: Any,
) -> tuple[GasFit, dict[str, float]]:
    """Fit the gas, and again with the file's values of what the recordings do not determine.

    Args:
        design: Start of the fit.
        runs: Recordings with the valve closed.
        known: Known values by name, SI.
        file_values: Chamber of the sensor file; None: that of `design`.
        options: Further arguments of `fit_gas`.

    Returns:
        The fit, and the known and held values by name.
    """
    chamber = file_values or design.chamber
    held = dict(known)
    found = fit_gas(design, runs, known=held, **options)
    if _first_undetermined(found.names, found.values, found.cov, "chamber", _HEAT) is not None:
        held |= {name: getattr(chamber, name) for name in _HEAT if name not in known}
        found = fit_gas(design, runs, known=held, **options)
    volume_sd_max = GAS_FRACTION * design.chamber_volume_flat
    if "extra_volume" in found.names and math.sqrt(found.cov[0][0]) > volume_sd_max:
        held |= {"extra_volume": chamber.extra_volume}
        found = fit_gas(design, runs, known=held, **options)
    return found, held


def _report_gas(found: GasFit) -> str:
    return f"gas: {', '.join(f'{name} {value:.4g}' for name, value in found.values.items())}"


def _check(design: SensorDesign, evidence: Evidence, mesh: tuple[int, int] | None) -> list[HeldOut]:
    rows = []
    simulated = simulate(design, evidence, 0.0, mesh)
    for hold, found in zip(evidence.states, simulated, strict=True):
        move = hold.move
        rows.append(
            HeldOut(
                evidence.name,
                math.nan if move is None else move.depth,
                0.0 if move is None else move.shear,
                hold.pressure,
                float(np.sqrt(np.nanmean(np.square(found.p_SM - hold.p_SM)))),
                -float(found.force[2]),
                hold.force,
            )
        )
    return rows
