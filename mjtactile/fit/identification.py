"""Identification of a sensor file from recordings: fit membrane, gas and images, then validate on
held-out recordings."""

from __future__ import annotations

import math
import time as wall
import tomllib
from collections.abc import Callable, Mapping, Sequence
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
from mjtactile.fit.membrane_fit import (
    DEFAULT,
    FitOptions,
    MembraneFit,
    fit_membrane,
    replay,
    simulate,
)
from mjtactile.fit.parameter_info import ABOUT, GAS_FRACTION, correlations
from mjtactile.fit.result import FIELD, SI, FitResult, HeldOut, covariance_of, numbers_of
from mjtactile.fit.rewrite_sensor_file import rewrite
from mjtactile.recording.reader import load_recording
from mjtactile.sim.attach import default_mesh

# order in which undetermined parameters are fixed: those closest to their design value first
_HEAT = ("heat_exchange", "polytropic_exponent")
_FINER = 4 / 3  # mesh refinement for the discretization error
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
    evidence = [read_evidence(path, design, options.finger, options.notify) for path in recordings]
    free, membrane = _fit_membrane(design, evidence, manually["membrane"], options)
    image = fit_image_noise(_with_lens(design, membrane.focal_scale), evidence[0].flat)
    gas = _gas(membrane, evidence, manually["chamber"], options)
    numbers = tuple(numbers_of(nominal, known, evidence, membrane, gas, image))
    names, cov = covariance_of(free, gas, "membrane.thickness_mm" in known)
    sentences = correlations(names, cov, {number.field: number.state for number in numbers})
    found = rewrite(
        text, numbers, f"Fitted by `mjtactile fit` to {', '.join(e.name for e in evidence)}."
    )
    fitted = sensor_from_table(tomllib.loads(found), name=options.name, source=options.name)
    checks = tuple(
        check
        for path in held_out
        for check in _check(
            fitted, read_evidence(path, design, options.finger, options.notify), options.mesh
        )
    )
    return FitResult(
        fitted,
        found,
        numbers,
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


def _fit_membrane(
    design: SensorDesign,
    evidence: Sequence[Evidence],
    known: Mapping[str, float],
    options: FitOptions,
) -> tuple[MembraneFit, MembraneFit]:
    """Return two membrane fits: all unknown parameters free, and undetermined ones fixed.

    A fixed parameter has the file's value. The second fit makes correlated parameters consistent
    with it.
    """
    free = membrane = fit_membrane(design, evidence, known=known, options=options)
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
    indentations over time.
    """
    with_pressure = [
        i for i, e in enumerate(evidence) if e.has_pressure and np.isfinite(e.series.pressure).all()
    ]
    holds = [membrane.holds[i] for i in with_pressure]
    runs = sealed_runs([evidence[i] for i in with_pressure], holds)
    if not runs:
        return None
    start, _ = _fit_determined(membrane.design, runs, known)
    options.notify(_report_gas(start))
    design = replace(membrane.design, chamber=replace(membrane.design.chamber, **start.values))
    models = [
        _replayed(evidence[i], membrane.offsets[i], options.mesh)
        if _can_replay(evidence[i])
        else predict
        for i in with_pressure
    ]
    recordings = [(evidence[i], membrane.offsets[i]) for i in with_pressure]
    modes = _modes(design, recordings, membrane, options.mesh or default_mesh(design))
    file_values = membrane.design.chamber
    found, held = _fit_determined(
        design, runs, known, file_values, models=models, modes=modes, iterations=2
    )
    options.notify(_report_gas(found))
    for name in held.keys() - known.keys():
        options.notify(f"gas: the recordings do not determine {name}; it keeps the file's value")
    return found


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


def _can_replay(evidence: Evidence) -> bool:
    """Return True for a recording with contact at known depths and without shear.

    Shear contains little information on the gas and takes long to simulate.
    """
    moves = evidence.stage.moves if evidence.stage else ()
    return any(move.touches for move in moves) and not any(
        move.is_weight or move.shear for move in moves
    )


def _modes(
    design: SensorDesign,
    recordings: Sequence[tuple[Evidence, float]],
    membrane: MembraneFit,
    mesh: tuple[int, int],
) -> list[list[Array]]:
    """Return the pressure errors of replayed recordings, each for one sd of a cause.

    The causes are the first contact of each recording, modulus and pre-stretch along the axes of
    their covariance, and the discretization by the mesh. The last two are common to all recordings.

    Args:
        design: Start of the fit.
        recordings: Recordings with pressures, and the offset of their first contact, m.
        membrane: Result of the membrane fit.
        mesh: Vertices of the simulated membrane.

    Returns:
        For each cause, the pressure error of each recording, (time,) Pa; 0 where it is not
        replayed.
    """

    def pressures(
        changed: SensorDesign, mesh: tuple[int, int], touched: Evidence | None = None
    ) -> list[Array]:
        """Replay all recordings, or the one with another first contact; 0: not replayed."""
        return [
            replay(changed, e, offset + (_touch_sd(membrane, e) if e is touched else 0.0), mesh)
            if _can_replay(e) and touched in (None, e)
            else np.zeros(len(e.series.time))
            for e, offset in recordings
        ]

    base = pressures(design, mesh)
    modes = []
    for number, (e, _) in enumerate(recordings):
        if _can_replay(e):
            mode = pressures(design, mesh, e)
            mode[number] -= base[number]
            modes.append(mode)
    finer = tuple(2 * round(_FINER * (count - 1) / 2) + 1 for count in mesh)
    scale = 1 / (1 - _FINER**-2)  # extrapolated to an infinitely fine mesh: second order
    others = [(changed, mesh, 1.0) for changed in _membranes_within(design, membrane)]
    for changed, grid, factor in [*others, (design, (finer[0], finer[1]), scale)]:
        moved = pressures(changed, grid)
        modes.append([factor * (p - before) for p, before in zip(moved, base, strict=True)])
    return modes


def _touch_sd(membrane: MembraneFit, evidence: Evidence) -> float:
    i = membrane.names.index(f"first touch of {evidence.name}")
    return math.sqrt(membrane.cov[i][i])


def _membranes_within(design: SensorDesign, membrane: MembraneFit) -> list[SensorDesign]:
    """Return the sensor with modulus and pre-stretch one sd off, along each axis of their
    covariance."""
    names = [name for name in ("young", "pre_stretch") if name in membrane.names]
    rows = [membrane.names.index(name) for name in names]
    values = np.array([membrane.values[name] for name in names])
    if not names:
        return []
    relative = membrane.cov[np.ix_(rows, rows)] / np.outer(values, values)
    spread, axes = np.linalg.eigh(relative)
    moved = values * (1 + (axes * np.sqrt(np.maximum(spread, 0.0))).T)
    return [
        replace(
            design, membrane=replace(design.membrane, **dict(zip(names, row.tolist(), strict=True)))
        )
        for row in moved
    ]


def _replayed(
    evidence: Evidence, offset: float, mesh: tuple[int, int] | None
) -> Callable[..., Array]:
    return lambda design, run: replay(design, evidence, offset, mesh)


def _check(design: SensorDesign, evidence: Evidence, mesh: tuple[int, int] | None) -> list[HeldOut]:
    rows = []
    simulated = simulate(design, evidence, 0.0, mesh)
    for hold, found in zip((evidence.rest, *evidence.holds), simulated, strict=True):
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
