"""What no controller can exceed."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.types import Command

# Pa: what an image may find changed (the sensing chain takes 60 for a valve that has jumped)
PRESSURE_STEP = 45.0


@dataclass(frozen=True)
class CommandLimits:
    """What no controller can exceed: `opening` m (lowest, highest), `speed` m/s of the opening,
    `force` N of the servo, `lift` m (lowest, highest), `lift_speed` m/s; `pressure` Pa above
    ambient in the chambers (lowest, highest; None: no valve obeys, or has no gauge) and
    `pressure_rate` Pa/s, at most `PRESSURE_STEP` in a period."""

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
