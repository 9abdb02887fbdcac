"""Kernel state of a quasi-static membrane, and the chamber's gas coupled to it.

For sealed gas the membrane uses p V^exponent, for any volume change within a step. Gas that flows,
leaks or warms is passed to the membrane once per time instant.
"""

from __future__ import annotations

import math

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneStatus
from mjtactile.quasistatic.incremental import HEAT_RATIO, IncrementalMembrane
from mjtactile.sim.sensor.gas import ChamberGas

STATE = np.dtype([
    ("touching", float),  # number of bodies in contact
    ("wrench", float, 6),  # on the membrane about the origin of S, N and N m
    ("middle", float, 3),  # center of pressure, m
    ("radius", float),  # mean distance of the pressure from it in the frame's plane, m
    ("slides", float),  # 1 if a body is at the friction limit
    ("slid", float),  # sliding distance since first touch, m: bodies weighted by force
    ("near", float),  # number of near bodies
    ("status", float),
    ("lost", float),  # steps without a solution in a row
    ("solved", float),
    ("lift", float),  # height by which the obstacles are raised for a solution, m
    ("pause", float),
    ("uncertain", float),  # extrapolated force, N, while there is no solution
    ("gripped", float),
    ("gas", float),  # gas settings of the last solution
    ("is_sealed", float),
    ("time", float),
    ("observed_gas", float, 2),
])  # fmt: skip
"""State of one quasi-static membrane between updates, as in kernels/qs_friction.h. SI units, S."""
PATCH = np.dtype([
    ("touching", float),
    ("near", float),
    ("known", float),
    ("wrench", float, 6),  # on the membrane about the origin of S, N and N m
    ("middle", float, 3),
    ("radius", float),
    ("slides", float),
    ("shear", float, 3),
    ("rest", float, 40),
])  # fmt: skip
"""State of one body at the membrane, as in kernels/qs_friction.h. SI units, S."""
_FLAT = 1.0  # pressure, Pa, below which the membrane is flat
_SEALED = 1  # index in a membrane's settings


class QuasistaticGas:
    """Gas and quasi-static membrane of one sensor. SI units."""

    def __init__(
        self,
        gas: ChamberGas,
        live: IncrementalMembrane,
        state: np.void,
        stiffness: Array,
        timestep: float,
        time: float,
    ):
        """Connect the gas. `stiffness` (1,), -dp/dV, Pa/m^3, is written here for the kernel."""
        self._gas = gas
        self._live = live
        self._state = state
        self._stiffness = stiffness
        self._timestep = timestep
        self._flat_volume = live.membrane.design.chamber_volume_flat
        # volume and time of the last gas update
        self._volume = self._flat_volume
        self._time = time
        self._reported_at = math.nan
        """Time of the last update of the membrane's gas state, s."""
        self._detected_at: tuple[float, float] | None = None
        """Time, s, and volume, m^3, of the last evaluation by `at`."""
        self._found = gas
        gas.advance(self._volume, 0.0)

    @property
    def volume(self) -> float:
        """Gas volume at the membrane's last update, m^3."""
        return self._flat_volume + self._live.volume

    def gauge_pressure(self, time: float) -> float:
        """Return the gauge pressure at the membrane's last update, Pa."""
        if self._gas.is_sealed and self._is_sealed:
            return self._live.gauge_pressure  # the membrane solution includes p V^gamma
        return self.at(time).gauge_pressure

    def at(self, time: float) -> ChamberGas:
        """Return the gas at the membrane's present volume, without changing the state."""
        moment = time, self.volume
        if self._detected_at != moment:
            self._detected_at = moment
            self._found = self._gas.at(self.volume, time - self._time)
        return self._found

    def wake(self) -> None:
        """Evaluate the gas again after a change of valve or leak."""
        self._reported_at = math.nan
        self._detected_at = None

    def advance(self, time: float) -> None:
        """Advance the gas to the membrane's present volume."""
        self._volume = self.volume
        self._gas.advance(self._volume, time - self._time)
        self._time = time
        self._detected_at = None

    def update_membrane(self, time: float) -> None:
        """Pass the present gas behavior to the membrane."""
        if self._gas.is_sealed:
            if not self._is_sealed:
                self.advance(time)
                self._seal()
        elif self._reported_at != time:
            self.advance(time)
            self._let_flow()
            self._reported_at = time

    def hold(self, time: float) -> bool:
        """Treat the gas as sealed for some steps; False while the valve is open."""
        if self._gas.is_sealed:
            return self._is_sealed
        if self._gas.is_open or not self._gas.stiffness(self._timestep) > 0:
            return False
        self.update_membrane(time)
        return True

    def close(self) -> None:
        """Mark the membrane's gas state as outdated after the valve has closed."""
        self._live.settings[_SEALED] = 0.0

    def seal(self, gauge_pressure: float, time: float) -> None:
        """Seal the gas at `gauge_pressure` Pa in the membrane's present volume."""
        self._volume = self.volume
        self._gas.seal(self._volume, gauge_pressure)
        self._time = time
        self.wake()

    @property
    def _is_sealed(self) -> bool:
        """True if the membrane treats the gas as sealed."""
        return bool(self._live.settings[_SEALED])

    def _seal(self) -> None:
        """Seal the gas from now on."""
        gas = self._gas
        stiffness = gas.stiffness(self._timestep)
        absolute = gas.gauge_pressure + gas.ambient
        exponent = stiffness * self._volume / absolute
        self._stiffness[0] = stiffness
        self._live.constants[HEAT_RATIO] = exponent
        self._live.settings[:2] = absolute * self._volume**exponent, True

    def _let_flow(self) -> None:
        """Set the membrane's gas state for gas that flows, leaks or warms, or for an open valve."""
        gas = self._gas
        live = self._live
        if gas.stiffness(self._timestep) > 0:
            self._seal()
            return
        pressure = gas.supply_gauge if gas.is_open else gas.gauge_pressure
        self._stiffness[0] = 0.0
        if not self._is_sealed and live.settings[0] == pressure:
            return
        if abs(pressure) < _FLAT and not self._state["touching"]:
            live.lie_flat()
            self._state["gas"] = pressure
            self._state["is_sealed"] = 0.0
        elif live.go_to_pressure(pressure) != MembraneStatus.CONVERGED:
            self._state["lost"] += 1
        live.settings[:2] = pressure, 0.0
