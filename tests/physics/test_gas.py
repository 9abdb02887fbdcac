"""The gas against closed forms: Boyle, adiabatic, the heat exchange between them, valve, leak. No
membrane in sight."""

import math

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import Chamber
from mjtactile.sim.sensor.gas import ChamberGas

AMBIENT = 101325.0
VOLUME = 2.4e-5


def closed(gauge=1000.0, **chamber):
    """Return a chamber of 24 mL, filled to `gauge` Pa and closed."""
    gas = ChamberGas(Chamber(0.02, **chamber))
    gas.open(gauge)
    gas.advance(VOLUME, 0.0)
    gas.close()
    return gas


def ramp(gas, end, duration, steps=200):
    """Change the volume from VOLUME to `end` at a constant relative rate."""
    for volume in VOLUME * (end / VOLUME) ** np.linspace(0, 1, steps + 1)[1:]:
        gas.advance(float(volume), duration / steps)
    return gas.gauge_pressure + AMBIENT


@pytest.mark.parametrize("polytropic_exponent", [1.0, 1.4])
def test_closed_gas_keeps_p_v_gamma(polytropic_exponent):
    gas = closed(polytropic_exponent=polytropic_exponent)
    absolute = ramp(gas, 0.8 * VOLUME, 1.0)
    # exact in each step: rounding only
    assert absolute * 0.8**polytropic_exponent == pytest.approx(102325.0, rel=1e-12)
    expected = 293.15 * 0.8 ** (1 - polytropic_exponent)
    assert gas.temperature == pytest.approx(expected, rel=1e-12)


def test_heat_exchange_changes_the_gas_from_adiabatic_to_isothermal():
    fast = ramp(closed(polytropic_exponent=1.4, heat_exchange=1.0), 0.9 * VOLUME, 1e-6)
    slow = ramp(closed(polytropic_exponent=1.4, heat_exchange=1.0), 0.9 * VOLUME, 1e4)
    assert fast == pytest.approx(102325.0 / 0.9**1.4, rel=1e-6)  # 1 us against 1 s
    assert slow == pytest.approx(102325.0 / 0.9, rel=1e-4)  # lag of 0.4 x 0.1 x 1 s / 10 000 s


def test_after_a_quick_squeeze_the_pressure_decays_with_the_time_constant():
    tau = 0.8
    gas = closed(polytropic_exponent=1.4, heat_exchange=tau)
    start = ramp(gas, 0.9 * VOLUME, 1e-9)
    end = 102325.0 / 0.9
    for _ in range(100):
        gas.advance(0.9 * VOLUME, 0.01)
    expected = end + (start - end) * math.exp(-1.0 / tau)
    # exact at constant volume
    assert gas.gauge_pressure + AMBIENT == pytest.approx(expected, rel=1e-9)


def test_one_step_equals_many_at_a_constant_relative_rate():
    once = ramp(closed(polytropic_exponent=1.4, heat_exchange=0.5), 0.7 * VOLUME, 0.3, steps=1)
    many = ramp(closed(polytropic_exponent=1.4, heat_exchange=0.5), 0.7 * VOLUME, 0.3, steps=1000)
    assert once == pytest.approx(many, rel=1e-10)  # the solution is exact for such a ramp


@pytest.mark.parametrize(
    "chamber",
    [
        {},
        {"polytropic_exponent": 1.4},
        {"polytropic_exponent": 1.4, "heat_exchange": 0.01},
        {"polytropic_exponent": 1.4, "leak_conductance": 1e-8},
    ],
)
@pytest.mark.parametrize("step", [1e-3, 8e-3])
def test_stiffness_is_the_response_of_the_next_step(chamber, step):
    def pressure(change):
        gas = closed(0.0, **chamber)  # at ambient pressure and temperature: no flow
        gas.advance(VOLUME + change, step)
        return gas.gauge_pressure

    change = 1e-5 * VOLUME
    slope = (pressure(-change) - pressure(change)) / (2 * change)
    # `advance` lets gas flow before and after the change, the stiffness during it: exp(-x/2)
    # against (1 - exp(-x))/x. They differ by x^2/24 with x = 0.47 at 8 ms. Without a leak only the
    # curvature of the law remains
    assert closed(0.0, **chamber).stiffness(step) == pytest.approx(
        slope, rel=0.02 if "leak_conductance" in chamber else 1e-6
    )


def test_an_open_valve_fills_with_its_time_constant():
    gas = closed(0.0, valve_conductance=1e-9)
    gas.open(500.0)
    tau = VOLUME / (1e-9 * (AMBIENT + 500.0))  # isothermal: V / (C p) = 0.24 s
    for _ in range(60):
        gas.advance(VOLUME, tau / 60)
    # the rate uses the higher pressure
    assert gas.gauge_pressure == pytest.approx(500 * (1 - math.exp(-1)), rel=1e-3)
    for _ in range(2000):
        gas.advance(VOLUME, tau / 60)
    assert gas.gauge_pressure == pytest.approx(500.0, abs=1e-6)
    gas.open(0.0)  # vent
    for _ in range(3000):
        gas.advance(VOLUME, tau / 60)
    assert gas.gauge_pressure == pytest.approx(0.0, abs=1e-6)


def test_charging_adiabatically_heats_by_gamma():
    """An evacuated rigid vessel that fills quickly from air at T ends at gamma T (first law,
    textbook)."""
    gas = closed(-0.999 * AMBIENT, polytropic_exponent=1.4, leak_conductance=1e-8)
    for _ in range(4000):
        gas.advance(VOLUME, 1e-4)
    assert gas.gauge_pressure == pytest.approx(0.0, abs=1.0)
    # 0.1 % of the gas was there before, at T
    assert gas.temperature == pytest.approx(1.4 * 293.15, rel=2e-3)


def test_a_leak_and_a_puncture_change_only_the_pressure():
    gas = closed(1000.0, leak_conductance=1e-9)
    amount = gas.amount
    for _ in range(5000):
        gas.advance(VOLUME, 1e-3)
    assert gas.gauge_pressure == pytest.approx(0.0, abs=1e-3)
    assert gas.amount == pytest.approx(amount * AMBIENT / (AMBIENT + 1000.0), rel=1e-6)
    gas = closed(1000.0)
    gas.puncture(1e-7)
    gas.advance(VOLUME, 1.0)  # a hundred time constants in one step
    assert gas.gauge_pressure == pytest.approx(0.0, abs=1.0)
    for bad in (-1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="leak_conductance"):
            gas.puncture(bad)


def test_ambient_pressure_and_temperature_are_parameters():
    """At high altitude (70 kPa) the same gauge pressure in the same volume is softer: k = p / V."""
    low, high = (closed(1000.0, ambient=a) for a in (70e3, 100e3))
    assert low.stiffness(1e-3) / high.stiffness(1e-3) == pytest.approx(71 / 101, rel=1e-12)
    cold = closed(1000.0, temperature=253.15)
    assert cold.amount == pytest.approx(102325.0 * VOLUME / 253.15, rel=1e-12)
