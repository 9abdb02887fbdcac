"""`mjtactile bench gas-filter-sensitivity`: effect of halving and doubling the gas filter's tuned
parameters.

The same pressure readings are filtered with each value. The chamber follows a closed form: an
indentation alone, or with a leak, a hole, warming, or a valve that opens to another pressure. The
pressure sensor has white noise. Volumes are those that images would measure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.design import load_sensor
from mjtactile.core.types import Array, PressureReading
from mjtactile.sensing.force.gas_filter import GasFilter
from mjtactile.sensing.force.spline_fem import Gas
from mjtactile.sensing.settings import DEFAULTS, GasFilterSettings
from mjtactile.sensing.settings.tunable_parameter import GAUGED

FACTORS = (0.5, 2.0)
CASES = ("dent", "leak", "hole", "warmth", "valve")
SEEDS = 6
REST = 1000.0  # gauge pressure without contact, Pa
NOISE = 3.0  # standard deviation of a reading, Pa
RATE = 100.0  # rate of the readings, Hz
SECONDS = 6.0
DENT = 0.005  # indentation as a fraction of the volume, applied from 1 to 1.5 s
DENT_FRACTION = 0.02  # relative error of an indentation's volume in the images
IMAGES = 3  # readings per image
_ALIKE = 0.005


@dataclass(frozen=True, eq=False)
class Readings:
    """Time series at `time` (n,), s.

    True `pressure` (n,), Pa above ambient, the readings `read`, `volume` (n,), m^3, and `is_open`,
    true while the valve is open.
    """

    time: Array
    pressure: Array
    read: Array
    volume: Array
    is_open: Array


def readings(case: str, seed: int) -> Readings:
    """Simulate the readings of one chamber of `dense` by the gas law."""
    design = load_sensor("dense")
    chamber = design.chamber
    rng = np.random.default_rng(seed)
    time = np.arange(1, round(SECONDS * RATE) + 1) / RATE
    volume = design.chamber_volume_flat * (1 - DENT * np.clip((time - 1) / 0.5, 0, 1))
    log_amount = {
        "leak": -8e-5 * time,
        "hole": -3e-3 * (1 - np.exp(-np.maximum(time - 2, 0) / 0.5)),
        "warmth": 2e-3 * (1 - np.exp(-time / 2)),
    }.get(case, np.zeros_like(time))
    squeezed = (design.chamber_volume_flat / volume) ** chamber.polytropic_exponent
    pressure = (chamber.ambient + REST) * squeezed * np.exp(log_amount) - chamber.ambient
    is_open = np.zeros(len(time), bool)
    if case == "valve":
        is_open = (time > 2) & (time < 3)
        moved = pressure[-1] + 400 * np.clip((time - 2) / 0.3, 0, 1)
        pressure = np.where(time > 2, moved, pressure)
    read = pressure + rng.normal(0, NOISE, len(time))
    return Readings(time, pressure, read, volume, is_open)


def follow(given: Readings, settings: GasFilterSettings) -> tuple[Array, Array, int]:
    """Return error and standard deviation of the pressure at each image, Pa.

    The third value counts the readings passed on to the fit of the images.
    """
    design = load_sensor("dense")
    chamber = design.chamber
    gauge = GasFilter(chamber, settings)
    volume = design.chamber_volume_flat
    sealed = Gas(REST, (chamber.ambient + REST) * volume**chamber.polytropic_exponent)
    state = gauge.start(sealed, 0.0, volume)
    errors = []
    sds = []
    setpoints = 0
    for k, time in enumerate(given.time.tolist()):
        reading = PressureReading(float(given.read[k]), NOISE, time, bool(given.is_open[k]))
        state, has_setpoint = gauge.read(gauge.switched(state, reading), reading)
        setpoints += has_setpoint
        if k % IMAGES == IMAGES - 1:
            state = gauge.after_image(state, time, float(given.volume[k]), DENT_FRACTION)
            gas, sd = gauge.gas_at(state, time)
            errors.append(gas.gauge_pressure - given.pressure[k])
            sds.append(sd)
    return np.array(errors), np.array(sds), setpoints


def measure(settings: GasFilterSettings, seeds: int) -> dict[str, float]:
    """Return rms error, Pa, median standard deviation, Pa, and used readings, over all cases."""
    errors, sds, setpoints = zip(
        *(follow(readings(case, seed), settings) for case in CASES for seed in range(seeds)),
        strict=True,
    )
    rms = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return {
        "rms_Pa": rms,
        "sd_Pa": float(np.median(np.concatenate(sds))),
        "setpoints": sum(setpoints),
    }


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Vary every parameter whose source states that it was tuned here."""
    seeds = 1 if quick else SEEDS
    default = DEFAULTS.gas_filter
    found = []
    for field in fields(default):
        if field.metadata["source"] != GAUGED:
            continue
        value = getattr(default, field.name)
        row: dict[str, Any] = {"name": f"gas_filter.{field.name}", "default": value}
        for factor in FACTORS:
            row[str(factor)] = measure(replace(default, **{field.name: factor * value}), seeds)
        found.append(row)
    return {"default": measure(default, seeds), "cases": CASES, "numbers": found}


def table(result: Mapping[str, Any]) -> str:
    """Format the effects of half and twice each parameter as a Markdown table."""
    usual = result["default"]
    lines = [
        f"Default parameters: pressure error {usual['rms_Pa']:.2f} Pa rms, median standard "
        f"deviation {usual['sd_Pa']:.2f} Pa, {usual['setpoints']} informative readings.",
        "",
        "| parameter | default | error factor | sd factor | informative readings |",
        "|---|---|---|---|---|",
    ]
    for row in result["numbers"]:
        half, twice = (row[str(factor)] for factor in FACTORS)
        cells = [_factors(half[key], twice[key], usual[key]) for key in ("rms_Pa", "sd_Pa")]
        setpoints = ""
        if (half["setpoints"], twice["setpoints"]) != (usual["setpoints"], usual["setpoints"]):
            setpoints = f"{half['setpoints']}/{twice['setpoints']}"
        lines.append(
            f"| `{row['name']}` | {row['default']:g} | {' | '.join([*cells, setpoints])} |"
        )
    return "\n".join(lines) + "\n"


def _factors(half: float, twice: float, usual: float) -> str:
    """Format the factors at half and at twice; "" if both are unchanged."""
    fractions = (half / usual, twice / usual)
    if all(abs(fraction - 1) < _ALIKE for fraction in fractions):
        return ""
    return f"{fractions[0]:.2f}/{fractions[1]:.2f}"
