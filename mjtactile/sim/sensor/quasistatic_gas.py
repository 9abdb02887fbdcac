"""`QuasistaticGas`: a chamber's gas, as the film over it feels it.

Gas that stays in is p V^exponent to the film, whatever its volume does within a step. What flows,
leaks or warms is told to the film once of each moment: so that the film is the same however often
anybody looks.
"""

from __future__ import annotations

import math

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneStatus
from mjtactile.quasistatic.incremental import HEAT_RATIO, IncrementalMembrane
from mjtactile.sim.sensor.gas import ChamberGas
from mjtactile.sim.sensor.quasistatic_state import QuasistaticState

_FLAT = 1.0  # Pa, below which the sheet lies flat
_SEALED = 1  # place of it in a film's settings


class QuasistaticGas:
    """Gas and film of one sensor. SI units."""

    def __init__(
        self,
        gas: ChamberGas,
        live: IncrementalMembrane,
        memory: QuasistaticState,
        stiffness: Array,
        timestep: float,
        time: float,
    ):
        """`stiffness` (1,) -dp/dV, Pa/m^3, is written here, for the kernel to read; `time` s is
        now."""
        self._gas = gas
        self._live = live
        self._memory = memory
        self._stiffness = stiffness
        self._timestep = timestep
        self._flat_volume = live.film.design.chamber_volume_flat
        # what the gas was last advanced to
        self._volume = self._flat_volume
        self._time = time
        self._reported_at = math.nan
        """s, when the film was last told what its gas does."""
        self._detected_at: tuple[float, float] | None = None
        """s and m^3, of what `at` last found."""
        self._found = gas
        gas.advance(self._volume, 0.0)

    @property
    def volume(self) -> float:
        """m^3, at the film's last look."""
        return self._flat_volume + self._live.volume

    def gauge_pressure(self, time: float) -> float:
        """Pa, at the film's last look."""
        if self._gas.is_sealed and self._is_sealed:
            return self._live.gauge_pressure  # the film rests on p V^gamma
        return self.at(time).gauge_pressure

    def at(self, time: float) -> ChamberGas:
        """The gas at the film's present volume; to look at, for what looks changes nothing."""
        moment = time, self.volume
        if self._detected_at != moment:
            self._detected_at = moment
            self._found = self._gas.at(self.volume, time - self._time)
        return self._found

    def wake(self) -> None:
        """See the gas anew: its valve or its leak is another."""
        self._reported_at = math.nan
        self._detected_at = None

    def breathe(self, time: float) -> None:
        """Take the gas to the film's present volume."""
        self._volume = self.volume
        self._gas.advance(self._volume, time - self._time)
        self._time = time
        self._detected_at = None

    def tell(self, time: float) -> None:
        """Tell the film what its gas does from now on."""
        if self._gas.is_sealed:
            if not self._is_sealed:
                self.breathe(time)
                self._seal()
        elif self._reported_at != time:
            self.breathe(time)
            self._let_flow()
            self._reported_at = time

    def hold(self, time: float) -> bool:
        """Take the gas as sealed for some steps: what leaks or warms does so slowly.

        Returns:
            Whether that can be: not while the valve is open.
        """
        if self._gas.is_sealed:
            return self._is_sealed
        if self._gas.is_open or not self._gas.stiffness(self._timestep) > 0:
            return False
        self.tell(time)
        return True

    def close(self) -> None:
        """See to it that the film is told of a valve that has closed."""
        self._live.settings[_SEALED] = 0.0

    def trap(self, gauge_pressure: float, time: float) -> None:
        """Be sealed at `gauge_pressure` Pa in the film's present volume."""
        self._volume = self.volume
        self._gas.seal(self._volume, gauge_pressure)
        self._time = time
        self.wake()

    @property
    def _is_sealed(self) -> bool:
        """Whether the film takes the gas as sealed."""
        return bool(self._live.settings[_SEALED])

    def _seal(self) -> None:
        """From now on the gas stays in."""
        gas = self._gas
        stiffness = gas.stiffness(self._timestep)
        absolute = gas.gauge_pressure + gas.ambient
        exponent = stiffness * self._volume / absolute
        self._stiffness[0] = stiffness
        self._live.numbers[HEAT_RATIO] = exponent
        self._live.settings[:2] = absolute * self._volume**exponent, True

    def _let_flow(self) -> None:
        """Set what the film feels of a gas that flows, leaks or warms, or of an open valve."""
        gas = self._gas
        live = self._live
        if gas.stiffness(self._timestep) > 0:
            self._seal()
            return
        pressure = gas.supply_gauge if gas.is_open else gas.gauge_pressure
        self._stiffness[0] = 0.0
        if not self._is_sealed and live.settings[0] == pressure:
            return
        if abs(pressure) < _FLAT and not self._memory.is_touched:
            live.lie_flat()
            self._memory.rest_at(pressure)
        elif live.go_to_pressure(pressure) != MembraneStatus.CONVERGED:
            self._memory.lose()
        live.settings[:2] = pressure, 0.0
