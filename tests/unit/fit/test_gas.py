"""The gas from pressure and volume over time, against closed forms: Boyle, a leak's exponential, a
wall's time constant."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.fit.gas import SHARED, Sealed, _correlated_count, fit_gas, predict

DENSE = load_sensor("dense")
AMBIENT = DENSE.chamber.ambient
RNG = np.random.default_rng(5)
NOISE = 5.0  # pressure noise, Pa
HEAT = {"polytropic_exponent": 1.0, "heat_exchange": 1.0}


def run_of(time, pressure, volume):
    return Sealed("run", time, pressure + RNG.normal(0, NOISE, len(time)), volume)


def test_gas_volume_by_boyles_law():
    """The fit recovers the gas volume from Boyle's law: p (V0 + v) is constant.

    An indentation of 0.4 of 30 mL is 1 % of 102 kPa: 1360 Pa. With 5 Pa of noise, 300 readings
    determine it to 0.03 %. The volume is then known to that, too. The 0.5 % leave room for the
    prior's pull.
    """
    flat = 30e-6
    time = np.arange(300) / 30
    volume = 1.4e-6 - 0.4e-6 * (np.sin(time - 1) > 0)
    pressure = (1000.0 + AMBIENT) * (flat + volume[0]) / (flat + volume) - AMBIENT
    found = fit_gas(DENSE, [run_of(time, pressure, volume)], known=HEAT | {"leak_conductance": 0.0})
    assert DENSE.chamber_volume_flat + found.values["extra_volume"] == pytest.approx(flat, rel=5e-3)
    assert 0 < np.sqrt(found.cov[0, 0]) < 0.02 * flat


def test_leak_by_its_exponential():
    """At a constant volume p falls as exp(-C p_a t / V) while p is small against p_a (1 %, which is
    the tolerance)."""
    leak = 2e-11
    time = np.arange(600) / 10
    volume = np.full(600, 1.4e-6)
    rate = leak * (AMBIENT + 800.0) / (DENSE.chamber_volume_flat + volume[0])
    found = fit_gas(
        DENSE,
        [run_of(time, 1000.0 * np.exp(-rate * time), volume)],
        known=HEAT | {"extra_volume": 0.0},
    )
    assert found.values["leak_conductance"] == pytest.approx(leak, rel=0.02)


def test_heat_after_a_fast_press():
    """A sudden press of dV heats an ideal gas by (gamma - 1) T dV/V, which the walls take with
    their time constant."""
    gamma = 1.35
    tau = 0.8
    flat = DENSE.chamber_volume_flat
    time = np.arange(300) / 30
    before = flat + 1.4e-6
    after = flat + 1.0e-6
    volume = np.where(time < 1, before, after) - flat
    start = 1000.0 + AMBIENT
    # the press happens between two images
    cooled = np.exp(-np.clip(time - 1 + 1 / 60, 0, None) / tau)
    pressure = (
        np.where(
            time < 1,
            start,
            start * before / after * (1 + ((before / after) ** (gamma - 1) - 1) * cooled),
        )
        - AMBIENT
    )
    found = fit_gas(
        DENSE,
        [run_of(time, pressure, volume)],
        known={"leak_conductance": 0.0, "extra_volume": 0.0},
    )
    # 5 Pa of 470 Pa, fifty readings
    assert found.values["polytropic_exponent"] == pytest.approx(gamma, abs=0.01)
    assert found.values["heat_exchange"] == pytest.approx(tau, rel=0.04)


def test_a_gas_at_constant_pressure_determines_no_parameter():
    """With almost constant volume, the amount of gas and its heat exchange stay unknown, and the
    covariance states it."""
    time = np.arange(100) / 30
    found = fit_gas(
        replace(DENSE),
        [run_of(time, np.full(100, 1000.0), np.full(100, 1.4e-6))],
        known={"leak_conductance": 0.0},
    )
    sd = dict(zip(found.names, np.sqrt(np.diag(found.cov)), strict=True))
    assert sd["extra_volume"] > 0.1 * DENSE.chamber_volume_flat and sd["polytropic_exponent"] > 0.2


def slow_error(rng, count, sd, correlation):
    """Return a first-order autoregressive error."""
    error = np.empty(count)
    error[:15] = 0.0  # the model starts at the pressure measured here
    for i in range(15, count):
        own = rng.normal(0, sd * np.sqrt(1 - correlation**2))
        error[i] = correlation * error[i - 1] + own
    return error


def test_correlated_residuals_count_by_their_autocorrelation():
    """An autoregressive error of coefficient r has (1 + r) / (1 - r) correlated neighbors."""
    rng = np.random.default_rng(1)
    slow = slow_error(rng, 20000, 1.0, 0.9)
    assert _correlated_count(slow) == pytest.approx(1.9 / 0.1, rel=0.25)
    assert _correlated_count(rng.normal(size=3000)) == SHARED  # the minimum


def test_intervals_cover_slow_pressure_errors():
    """A slow error of 20 Pa moves the gas volume by more than independent errors of 20 Pa would.

    Of 20 runs, 95 % are expected within two sd; 15 are fewer with a probability below 0.1 %.
    """
    flat = 30e-6
    time = np.arange(300) / 30
    volume = 1.4e-6 - 0.4e-6 * (np.sin(time - 1) > 0)
    pressure = (1000.0 + AMBIENT) * (flat + volume[0]) / (flat + volume) - AMBIENT
    inside = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        observed = pressure + slow_error(rng, 300, 20.0, 0.9) + rng.normal(0, NOISE, 300)
        run = Sealed("run", time, observed, volume)
        found = fit_gas(DENSE, [run], known=HEAT | {"leak_conductance": 0.0})
        off = DENSE.chamber_volume_flat + found.values["extra_volume"] - flat
        inside += abs(off) < 2 * np.sqrt(found.cov[0, 0])
    assert inside >= 15


def test_a_common_error_of_two_runs_does_not_average_out():
    """A displaced volume that is 2 % too large in all runs makes the gas volume 2 % too large.

    The mode states that error as one for both runs, so that its sd stays 2 %. With an error for
    each run it would be 1.4 %.
    """
    flat = 30e-6
    time = np.arange(300) / 30
    volume = 1.4e-6 - 0.4e-6 * (np.sin(time - 1) > 0)
    pressure = (1000.0 + AMBIENT) * (flat + volume[0]) / (flat + volume) - AMBIENT
    runs = [run_of(time, pressure, volume) for _ in range(2)]
    change = 0.02 * (pressure - 1000.0)
    none = np.zeros(300)
    fixed = HEAT | {"leak_conductance": 0.0}
    common = fit_gas(DENSE, runs, known=fixed, modes=[[change, change]])
    separate = fit_gas(DENSE, runs, known=fixed, modes=[[change, none], [none, change]])
    assert np.sqrt(common.cov[0, 0]) / flat == pytest.approx(0.02, rel=0.2)
    assert np.sqrt(separate.cov[0, 0] / common.cov[0, 0]) == pytest.approx(0.71, rel=0.1)


def test_a_wrong_first_volume_shifts_no_pressure():
    """A gas at rest stays at its pressure, although the first of its volumes is 5 uL too large.

    With that volume as the start, all others would be compressed: 20 Pa.
    """
    time = np.arange(60) / 30
    volume = np.full(60, 1.4e-6)
    volume[0] += 5e-9
    pressures = predict(DENSE, Sealed("run", time, np.full(60, 1000.0), volume))
    assert np.abs(pressures[1:] - 1000.0).max() < 1.0
