"""Gauge pressures that pump and pressure sensor must supply and measure.

A closed chamber's pressure rises with an indentation. The simulated indentations of the design
check and those of the protocols for `mjtactile fit` determine the range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mjtactile.core.design import SensorDesign
from mjtactile.fabrication.marker_positions import MembraneState
from mjtactile.fit.parameter_info import FIT_PRESSURES

_RESERVE = 1.1
# preferred upper limits of pressure ranges in each decade (EN 837-1)
_RANGES = (1.0, 1.6, 2.5, 4.0, 6.0, 10.0)


@dataclass(frozen=True)
class PressureLoads:
    """State with the highest gauge pressure; highest pressure of the pump, Pa."""

    highest: MembraneState
    pump: float

    @classmethod
    def of(
        cls,
        design: SensorDesign,
        states: Sequence[MembraneState],
        load_states: Sequence[MembraneState],
    ) -> PressureLoads:
        """Find the highest pressures of all states."""
        supply = design.chamber.supply_gauge
        pump = max(supply, *FIT_PRESSURES) if load_states and supply >= 0 else supply
        highest = max((*states, *load_states), key=lambda state: state.gauge_pressure)
        return cls(highest, pump)

    @property
    def sensor_range(self) -> float:
        """Upper limit of the pressure sensor's range, kPa, of the preferred values."""
        need = 1e-3 * _RESERVE * max(self.highest.gauge_pressure, abs(self.pump))
        decade = 10.0 ** math.floor(math.log10(need))
        return decade * next(limit for limit in _RANGES if need <= decade * limit * (1 + 1e-9))
