"""Gas behind the membrane, independent of MuJoCo: amount, temperature, pressure, valve, leaks.

The chamber is one well-mixed volume of ideal gas. Its state is the amount n R (J/K) and the
temperature T (K). The pressure follows from p V = n R T. Between two calls of `advance` the volume
changes at a constant relative rate. The equations are solved exactly for that rate, so any time
step is stable (docs/theory/gas.md, G4-G6).
"""

from __future__ import annotations

import math

from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import Chamber

# Tolerances for equilibrium, Pa and K; both correspond to 0.03 Pa at a gauge pressure of 1000 Pa.
_LEVEL = 0.01
_WARM = 1e-4


class ChamberGas:
    """Gas of one chamber. Pressures in Pa, volumes in m^3, time in s. "gauge" means above ambient.

    With an ideal valve (infinite conductance, the default) the open chamber is at the supply's
    pressure at once. With a finite one the gas flows at `conductance` x pressure difference.
    """

    def __init__(self, chamber: Chamber):
        self._chamber = chamber
        self.ambient = chamber.ambient
        self._supply_gauge = 0.0
        self._is_open = True
        self._leak = chamber.leak_conductance
        self._amount = math.nan
        self._temperature = chamber.temperature
        self._volume = math.nan
        # K, K/s
        self._wall = chamber.temperature
        self._warming = 0.0
        self._pressure = chamber.ambient  # absolute
        self._has_ideal_valve = math.isinf(chamber.valve_conductance)
        self._ways: tuple[tuple[float, float], ...] = ()
        """Conductance and far pressure, Pa absolute, of every flow path that is open now."""
        self._find_connections()

    @property
    def is_open(self) -> bool:
        return self._is_open

    @property
    def supply_gauge(self) -> float:
        """Pressure that the open valve connects to, Pa above ambient."""
        return self._supply_gauge

    @property
    def gauge_pressure(self) -> float:
        """Pressure in the chamber at the last `advance`, Pa above ambient."""
        return self._pressure - self.ambient

    @property
    def temperature(self) -> float:
        """Temperature of the gas at the last `advance`, K."""
        return self._temperature

    @property
    def amount(self) -> float:
        """n R of the trapped gas, J/K; NaN while an ideal valve is open."""
        return self._amount

    @property
    def is_still(self) -> bool:
        """True if the pressure is constant at constant volume: no flow, gas at wall temperature."""
        if self._is_ideally_open:
            return True
        if self._warming:
            return False
        level = all(abs(far - self._pressure) < _LEVEL for _, far in self._ways)
        return level and (
            math.isinf(self._chamber.heat_exchange) or abs(self._temperature - self._wall) < _WARM
        )

    @property
    def is_sealed(self) -> bool:
        """True if no gas flows and one exponent describes it: p V^gamma is constant."""
        if self._is_open or self._leak or self._warming:
            return False
        return math.isinf(self._chamber.heat_exchange) or self._chamber.polytropic_exponent == 1

    def open(self, supply_gauge: float) -> None:
        """Connect the chamber to a supply. Raises InputError for an impossible pressure."""
        if not math.isfinite(supply_gauge) or supply_gauge <= -self.ambient:
            raise InputError(
                f"{supply_gauge!r} Pa is not above vacuum (-{self.ambient:g} Pa)",
                source="valve",
                field="supply_gauge",
            )
        self._supply_gauge = float(supply_gauge)
        self._is_open = True
        self._find_connections()

    def close(self) -> None:
        """Close the valve and seal the current gas."""
        self._is_open = False
        self._find_connections()
        self._fill()

    def seal(self, volume: float, gauge_pressure: float) -> None:
        """Close the valve on `volume` m^3 of gas at `gauge_pressure` Pa and wall temperature."""
        self._is_open = False
        self._find_connections()
        self._volume = volume
        self._temperature = self._wall
        self._pressure = gauge_pressure + self.ambient
        self._amount = self._pressure * volume / self._temperature

    def puncture(self, conductance: float) -> None:
        """Open a hole to ambient of `conductance` m^3/(s Pa), 0 to mend it. Raises InputError."""
        if not math.isfinite(conductance) or conductance < 0:
            raise InputError(
                f"{conductance!r} m^3/(s Pa) is not a finite conductance >= 0",
                source="valve",
                field="leak_conductance",
            )
        self._fill()
        self._leak = conductance
        self._find_connections()

    def warm(self, rate: float) -> None:
        """Warm gas and walls by `rate`, K/s, from now on."""
        self._warming = rate

    def advance(self, volume: float, elapsed: float) -> None:
        """Advance the gas to `volume`, m^3, `elapsed` s after the last call (0: without heat or
        flow)."""
        if math.isnan(self._volume) or volume <= 0:
            self._volume = volume
        warmer = self._warming * max(elapsed, 0.0)
        self._wall += warmer
        if self._is_ideally_open:
            self._amount = math.nan
            self._temperature = self._wall
            self._pressure = self._supply_gauge + self.ambient
            self._volume = volume
            return
        self._fill()
        if volume > 0:
            elapsed = max(elapsed, 0.0)
            self._temperature += warmer
            self._flow_all(elapsed / 2)  # half before and half after: second order
            self._compress(volume, elapsed)
            self._flow_all(elapsed / 2)
            self._pressure = self._amount * self._temperature / volume

    def at(self, volume: float, elapsed: float) -> ChamberGas:
        """Return the gas after `advance`, and leave this one unchanged."""
        other = object.__new__(type(self))  # copy.copy takes ten times as long
        other.__dict__.update(self.__dict__)
        other.advance(volume, elapsed)
        return other

    def stiffness(self, step: float) -> float:
        """Return -dp/dV, Pa/m^3, for a volume change spread over the next `step` s.

        It is gamma p / V for an adiabatic gas, less with heat loss and outflow within the step.
        """
        if self._is_ideally_open or self._volume <= 0:
            return 0.0
        gamma = self._chamber.polytropic_exponent
        pressure = self._pressure
        rate = 0.0
        for conductance, far in self._ways:  # at every step: a sum takes twice as long
            rate += gamma * conductance * max(pressure, far) / self._volume
        stored_heat = _ramp_fraction(step / self._chamber.heat_exchange)
        return (
            pressure / self._volume * (1 + (gamma - 1) * stored_heat) * _ramp_fraction(rate * step)
        )

    @property
    def _is_ideally_open(self) -> bool:
        return self._is_open and self._has_ideal_valve

    def _find_connections(self) -> None:
        leak = [(self._leak, self.ambient)] if self._leak else []
        valve = (self._chamber.valve_conductance, self._supply_gauge + self.ambient)
        self._ways = (*leak, valve) if self._is_open and not self._has_ideal_valve else (*leak,)

    def _fill(self) -> None:
        """Compute the amount of gas, if it is unknown."""
        if math.isnan(self._amount):
            self._amount = self._pressure * self._volume / self._temperature

    def _compress(self, volume: float, elapsed: float) -> None:
        """Integrate dT/dt = -(gamma - 1) T (dV/dt)/V + (T_wall - T)/tau at a constant relative rate
        (Eq. G4)."""
        exchange = elapsed / self._chamber.heat_exchange
        decay = (self._chamber.polytropic_exponent - 1) * math.log(volume / self._volume) + exchange
        self._temperature = self._temperature * math.exp(
            -decay
        ) + self._wall * exchange * _ramp_fraction(decay)
        self._volume = volume

    def _flow_all(self, elapsed: float) -> None:
        for conductance, far in self._ways:
            self._flow(conductance, far, elapsed)

    def _flow(self, conductance: float, far: float, elapsed: float) -> None:
        """Move amount and enthalpy through an opening, at constant volume (Eq. G5-G6)."""
        gamma = self._chamber.polytropic_exponent
        pressure = self._amount * self._temperature / self._volume
        source = self._wall if far > pressure else self._temperature
        rate = gamma * conductance * max(pressure, far) / self._volume
        # V dp = gamma R T_source dn
        energy = (far - pressure) * self._volume * -math.expm1(-rate * elapsed)
        moved = energy / (gamma * source)
        temperature = (pressure * self._volume + energy) / (self._amount + moved)
        self._amount = self._amount + moved
        self._temperature = temperature


def _ramp_fraction(x: float) -> float:
    """Return (1 - exp(-x)) / x, the remaining fraction of a ramp after x time constants."""
    return -math.expm1(-x) / x if abs(x) > 1e-12 else 1.0
