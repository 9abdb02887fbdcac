"""Tests of the estimate while the gas in the chamber changes, against the force that the simulated
contact carries."""

from __future__ import annotations

import numpy as np
import pytest

import mjtactile
from benchmarks.camera_faults.gas_changes import BEFORE, FAULTS, MASS, errors, scene
from mjtactile.core.types import PressureReading
from mjtactile.sensing.force.gas_filter import GasFilter
from mjtactile.sensing.force.spline_fem import Gas

# force in N: three sd of an untouched sensor with pressure sensor, and the effect of a hole
TOLERANCE = 0.03
AFTER = 0.9  # duration after the change, s; the benchmark observes 2 s
BOUNCE = 0.4  # time in s that the ball swings and the membrane drags after a pressure jump


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "mass"),
    [
        *((fault, MASS) for fault in FAULTS),
        *((fault, None) for fault in ("valve to ambient", "valve to 2 kPa", "puncture")),
    ],
)
def test_force_is_accurate_or_unknown(fault: str, mass: float | None) -> None:
    model, data, finger = scene(mass)
    errors(model, data, finger, BEFORE)
    FAULTS[fault](finger)
    off, sd = np.abs(errors(model, data, finger, AFTER)).T
    swings = round(BOUNCE * finger.design.camera.rate)
    assert np.nanmax((off / np.maximum(TOLERANCE, 3 * sd))[:swings]) < 1
    assert np.nanmax(off[swings:]) < TOLERANCE
    # a valve that moves makes a few images unknown, a hole a few more
    assert np.isnan(off).sum() <= 10
    touch = finger.touch
    assert touch.traction is not None
    assert touch.traction.gauge_pressure == pytest.approx(finger.seen.gauge_pressure, abs=25.0)


def reading(pressure: float, time: float, *, is_open: bool = False) -> PressureReading:
    return PressureReading(pressure, 5.0, time, is_open)


def test_noise_of_the_pressure_sensor_is_averaged_and_leaks_are_tracked() -> None:
    """The closed form is that of a sealed volume that loses a fraction of its gas."""
    chamber = mjtactile.load_sensor("dense").chamber
    follow = GasFilter(chamber)
    volume = 24e-6
    constant = (chamber.ambient + 1000.0) * volume
    rng = np.random.default_rng(0)
    for loss, maximum in ((0.0, 3.0), (3e-4, 10.0)):  # 1/s; Pa: 0, and 30 Pa/s
        state = follow.start(Gas(1000.0, constant), 0.0, volume)
        for k in range(1, 200):
            time = k / 30
            true = (chamber.ambient + 1000.0) * np.exp(-loss * time) - chamber.ambient
            state = follow.after_image(state, time, volume, 0.03)
            state, _ = follow.read(state, reading(true + 5.0 * rng.standard_normal(), time))
        gas, sd = follow.gas_at(state, time)
        assert abs(gas.gauge_pressure - true) < maximum
        assert sd < maximum


def test_scale_error_of_the_pressure_sensor_grows_away_from_its_zero() -> None:
    """The pressure sensor's scale adds uncertainty far from its zero: half a percent of the 1 kPa
    that a valve has released, and zero at the rest pressure."""
    chamber = mjtactile.load_sensor("dense").chamber
    follow = GasFilter(chamber)
    first_state = follow.start(Gas(1000.0), 0.0, 24e-6)
    found = []
    for pressure in (1000.0, 0.0):
        state = first_state
        for k in range(1, 300):
            state, _ = follow.read(state, reading(pressure, k / 30, is_open=True))
        found.append(follow.gas_at(state, state.time)[1])
    at_rest, vented = found
    assert vented**2 - at_rest**2 == pytest.approx(5.0**2, rel=0.02)


def test_a_repeated_reading_does_not_change_the_estimate() -> None:
    chamber = mjtactile.load_sensor("dense").chamber
    follow = GasFilter(chamber)
    state = follow.start(Gas(1000.0, (chamber.ambient + 1000.0) * 24e-6), 0.0, 24e-6)
    once, _ = follow.read(state, reading(990.0, 0.1))
    again, surprised = follow.read(once, reading(950.0, 0.1))
    assert again is once and not surprised
