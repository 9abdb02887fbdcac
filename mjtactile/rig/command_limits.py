"""Limits of a rig that apply to every command."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from mjtactile.core.types.command import COMMAND_FIELDS, Command, CommandField


@dataclass(frozen=True)
class CommandLimits:
    """Limits that apply to the commands of every controller.

    `CommandField.limit` and `CommandField.rate` of a field of `Command` name its limits here.

    `opening`, m, is (minimum, maximum), with `speed` of the opening, m/s. `force` of the servo is
    in N. `lift`, m, is (minimum, maximum), with `lift_speed`, m/s. `pressure` in the chambers, Pa
    above ambient, is (minimum, maximum). None: no controlled valve, or no pressure sensor.
    `pressure_rate` is in Pa/s. The change per period is at most `PRESSURE_STEP`.
    """

    opening: tuple[float, float] = (0.0, 0.12)
    speed: float = 0.1
    force: float = 10.0
    lift: tuple[float, float] = (0.0, 0.15)
    lift_speed: float = 0.1
    pressure: tuple[float, float] | None = None
    pressure_rate: float = 1200.0

    def apply(self, requested: Command, last: Command, period: float) -> Command:
        """Return the command nearest to `requested` within the limits.

        The limits start from `last`, one `period` s ago.
        """
        values = {}
        for name, entry in COMMAND_FIELDS.items():
            value = getattr(requested, name)
            values[name] = self._limited(entry, value, getattr(last, name), period)
        return Command(**values)

    def clip(self, requested: Command) -> Command:
        """Return the command nearest to `requested` within the ranges, at any speed."""
        return self.apply(requested, requested, math.inf)

    def _limited(self, entry: CommandField, requested: Any, last: Any, period: float) -> Any:
        if requested is None or not entry.limit:
            return requested
        bounds = getattr(self, entry.limit)
        if bounds is None:
            return None
        low, high = bounds if isinstance(bounds, tuple) else (0.0, bounds)
        step = math.inf
        if entry.rate and period < math.inf:
            step = min(getattr(self, entry.rate) * period, entry.step_max)
        before = requested if last is None else last
        if not isinstance(requested, tuple):
            return _limited_value(requested, before, step, low, high)
        pairs = zip(requested, before, strict=True)
        return tuple(_limited_value(command, was, step, low, high) for command, was in pairs)


UNLIMITED = CommandLimits(
    opening=(0.0, math.inf),
    speed=math.inf,
    force=math.inf,
    lift=(-math.inf, math.inf),
    lift_speed=math.inf,
    pressure=(0.0, math.inf),
    pressure_rate=math.inf,
)
"""Limits that leave commands as they are, apart from negative openings, forces and pressures."""


def _limited_value(value: float, before: float, step: float, low: float, high: float) -> float:
    """Return the number nearest to `value` within `low` and `high`, no further from `before` than
    a `step`."""
    return min(max(value, before - step, low), before + step, high)
