"""Filter for the amount of gas in the chamber, from its pressure sensor (docs/theory/gas.md, Eq.
F17).

In a sealed chamber the gas law gives pressure from volume. Further pressure changes are changes of
the amount: a leak, warming, a hole. With an open valve the valve sets the pressure, which the
sensor measures. A Kalman filter tracks either value and its rate. An unexpected reading (a hole, a
moved valve) first inflates the covariance and is then accepted at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.sensor_parts import Chamber
from mjtactile.core.types import Array, PressureReading
from mjtactile.sensing.force.spline_fem import Gas
from mjtactile.sensing.settings import DEFAULTS, GasFilterSettings

# Standard deviation of the pressure after a valve has moved, relative to ambient. It is so wide
# that the first reading decides. Half and twice the value make no difference (`bench
# gas-filter-sensitivity`).
_MOVED = 1e-3


@dataclass(frozen=True, eq=False)
class GasState:
    """Estimated state of the gas at `time`, s.

    While `is_open`, `value` is the gauge pressure relative to the absolute ambient pressure. While
    sealed, it is the logarithm of the amount relative to `amount` (p V^gamma). `rate`, 1/s, is its
    derivative and `cov` (2, 2) the covariance of both. `surprise` is the mean of the last readings'
    deviations over their standard deviation. `seen` holds (time s, volume m^3) of the last images,
    the newest last. `zero` is the relative excess of gas that the membrane at rest shows over the
    pressure sensor. `rest` is the gauge pressure where the zero was observed, Pa.
    """

    time: float
    is_open: bool
    amount: float
    value: float
    rate: float
    cov: Array
    seen: tuple[tuple[float, float], ...]
    surprise: float = 0.0
    zero: float = 0.0
    rest: float = math.nan

    def corrected(self, fraction: float) -> GasState:
        """Return the state with `zero` raised by `fraction`, as observed on a membrane at rest. The
        cause is a drift of the pressure sensor's zero, or the weather."""
        return replace(self, zero=self.zero + fraction)

    def refine_estimate(self, volume: float) -> GasState:
        """Return the state with another volume, m^3, in the last image."""
        return replace(self, seen=(*self.seen[:-1], (self.seen[-1][0], volume)))

    def volume_at(self, time: float) -> tuple[float, float]:
        """Return the gas volume at `time` s, m^3, and the extrapolated part of it."""
        t0, v0 = self.seen[0]
        t1, v1 = self.seen[-1]
        if t1 <= t0:
            return v1, 0.0
        beyond = (v1 - v0) / (t1 - t0) * (time - t1)
        return v1 + beyond, max(time - t1, t0 - time, 0.0) * abs(v1 - v0) / (t1 - t0)


class GasFilter:
    """Follows one chamber's gas."""

    def __init__(self, chamber: Chamber, settings: GasFilterSettings = DEFAULTS.gas_filter):
        self._gamma = chamber.polytropic_exponent
        self._ambient = chamber.ambient
        self.settings = settings

    def start(self, gas: Gas, time: float, volume: float) -> GasState:
        """Return the state of the gas in equilibrium at `volume`, m^3, measured some time ago."""
        pressure = self._ambient + gas.pressure_at(volume, self._ambient, self._gamma)
        is_open = gas.constant is None
        return GasState(
            time,
            is_open,
            pressure * volume**self._gamma,
            gas.gauge_pressure / self._ambient if is_open else 0.0,
            0.0,
            np.diag([self.settings.drift, self.settings.rate]) ** 2,
            ((time, volume),),
            rest=pressure - self._ambient,
        )

    def gas_at(self, state: GasState, time: float) -> tuple[Gas, float]:
        """Return the gas at `time`, s, and the standard deviation of its pressure, Pa."""
        ahead = time - state.time
        value = state.value + state.rate * ahead
        cov = _propagated(state.cov, ahead) + self._noise(state, abs(ahead))
        if state.is_open:
            gas = Gas((value + state.zero) * self._ambient)
        else:
            amount = state.amount * math.exp(value + state.zero)
            volume = state.seen[-1][1]
            gas = Gas(amount / volume**self._gamma - self._ambient, amount)
        s = self.settings
        # scale error of a pressure sensor: proportional to the distance from its zero
        sd = math.hypot(
            math.sqrt(cov[0, 0]) * self._ambient,
            s.floor,
            s.scale * (gas.gauge_pressure - state.rest),
        )
        return gas, sd

    def after_image(
        self, state: GasState, time: float, volume: float, dent_fraction: float
    ) -> GasState:
        """Update the state after an image at `time`, s, with `volume`, m^3, whose change has the
        relative error `dent_fraction`."""
        cov = state.cov.copy()
        if not state.is_open:
            change = self._gamma * (volume - state.seen[-1][1]) / volume
            cov[0, 0] += (dent_fraction * change) ** 2
        return replace(state, seen=(*state.seen[-1:], (time, volume)), cov=cov)

    def switched(self, state: GasState, reading: PressureReading) -> GasState:
        """Return the state after the valve was opened or closed, as stated in the `reading`."""
        if reading.is_open == state.is_open:
            return state
        s = self.settings
        volume = state.seen[-1][1]
        if reading.is_open:
            amount = state.amount * math.exp(state.value)
            value = amount / volume**self._gamma / self._ambient - 1
            cov = np.diag([_MOVED, s.moving_rate]) ** 2
            return replace(state, is_open=True, value=value, rate=0.0, cov=cov, surprise=0.0)
        amount = (1 + state.value) * self._ambient * volume**self._gamma
        cov = np.diag([math.hypot(s.drift, math.sqrt(state.cov[0, 0])), s.rate]) ** 2
        return replace(
            state, is_open=False, amount=amount, value=0.0, rate=0.0, cov=cov, surprise=0.0
        )

    def read(self, state: GasState, reading: PressureReading) -> tuple[GasState, bool]:
        """Return the state after a reading, and True if it carries much new information. A reading
        that was already used changes nothing."""
        ahead = reading.time - state.time
        if not math.isfinite(reading.gauge_pressure) or ahead <= 0:
            return state, False
        s = self.settings
        value = state.value + state.rate * ahead
        cov = _propagated(state.cov, ahead) + self._noise(state, ahead)
        measured = reading.gauge_pressure / self._ambient
        variance = (reading.sd / self._ambient) ** 2
        if not state.is_open:
            volume, beyond = state.volume_at(reading.time)
            law = state.amount / volume**self._gamma / self._ambient
            measured = math.log(max(1 + measured, s.minimum) / law)
            variance += (self._gamma * beyond / volume) ** 2
        innovation = measured - value
        deviation = innovation / math.sqrt(cov[0, 0] + variance)
        surprise = state.surprise + s.blend * (deviation - state.surprise)
        surprised = abs(deviation) > s.deviation_max or abs(surprise) > s.surprise_max
        if surprised:
            surprise = 0.0
            cov[0, 0] += innovation**2
            cov[1, 1] += (innovation / max(ahead, s.shortest)) ** 2
        cov_before = cov[0, 0]
        gain = cov[:, 0] / (cov[0, 0] + variance)
        cov = cov - np.outer(gain, cov[0])
        return (
            replace(
                state,
                time=reading.time,
                value=value + gain[0] * innovation,
                rate=state.rate * math.exp(-ahead / s.rate_time) + gain[1] * innovation,
                cov=(cov + cov.T) / 2,
                surprise=surprise,
            ),
            surprised or cov_before > s.informative * variance,
        )

    def _noise(self, state: GasState, seconds: float) -> Array:
        """Return the process noise over `seconds`, in addition to the rate."""
        s = self.settings
        walk, rate = (s.open_walk, s.open_rate) if state.is_open else (s.walk, s.rate_walk)
        rate = math.hypot(
            rate, s.rate_fraction * state.rate
        )  # a hole's rate falls with the pressure
        return np.diag([walk**2 * seconds, rate**2 * seconds])


def _propagated(cov: Array, ahead: float) -> Array:
    F = np.array([[1.0, ahead], [0.0, 1.0]])
    return F @ cov @ F.T
