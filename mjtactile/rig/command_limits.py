"""Limits of a rig that apply to every command."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.types import Command

# Maximum pressure change between two images, Pa (the sensing pipeline treats 60 as a valve jump)
PRESSURE_STEP = 45.0


@dataclass(frozen=True)
class CommandLimits:
    """Limits that apply to the commands of every controller.

    `opening`, m, is (minimum, maximum), with `speed` of the opening, m/s. `force` of the servo is
    in N. `lift`, m, is (minimum, maximum), with `lift_speed`, m/s. `pressure` in the chambers, Pa
    above ambient, is (minimum, maximum). None: no controlled valve, or no pressure sensor.
    `pressure_rate` is in Pa/s; the change per period is at most `PRESSURE_STEP`.
    """

    opening: tuple[float, float] = (0.0, 0.12)
    speed: float = 0.1
    force: float = 10.0
    lift: tuple[float, float] = (0.0, 0.15)
    lift_speed: float = 0.1
    pressure: tuple[float, float] | None = None
    pressure_rate: float = 1200.0

    def apply(self, wanted: Command, last: Command, period: float) -> Command:
        """The command nearest to `wanted` that keeps the limits, starting from `last` one `period`
        s ago."""
        return Command(
            _near(wanted.opening, last.opening, self.speed * period, self.opening),
            None if wanted.force_limit is None else min(max(wanted.force_limit, 0.0), self.force),
            _near(wanted.lift_height, last.lift_height, self.lift_speed * period, self.lift),
            wanted.phase,
            wanted.memory,
            wanted.reason,
            self._air(wanted.gauge_pressure, last.gauge_pressure, period),
        )

    def _air(
        self, wanted: tuple[float, ...] | None, last: tuple[float, ...] | None, period: float
    ) -> tuple[float, ...] | None:
        if wanted is None or self.pressure is None:
            return None
        step = min(self.pressure_rate * period, PRESSURE_STEP)
        before = wanted if last is None else last
        pairs = zip(wanted, before, strict=True)
        return tuple(_near(one, was, step, self.pressure) for one, was in pairs)


def _near(value: float, before: float, step: float, bounds: tuple[float, float]) -> float:
    """`value`, no further from `before` than a `step`, within `bounds`."""
    return min(max(value, before - step, bounds[0]), before + step, bounds[1])
