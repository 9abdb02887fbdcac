"""What no controller can exceed."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.types import Command


@dataclass(frozen=True)
class Limits:
    """What no controller can exceed: `opening` m (lowest, highest), `speed` m/s of the opening,
    `force` N of the servo, `lift` m (lowest, highest), `lift_speed` m/s."""

    opening: tuple[float, float] = (0.0, 0.12)
    speed: float = 0.1
    force: float = 10.0
    lift: tuple[float, float] = (0.0, 0.15)
    lift_speed: float = 0.1

    def apply(self, wanted: Command, last: Command, period: float) -> Command:
        """The command nearest to `wanted` that keeps the limits, starting from `last` one `period`
        s ago."""

        def limit(value: float, before: float, speed: float, bounds: tuple[float, float]) -> float:
            step = speed * period
            return min(max(value, before - step, bounds[0]), before + step, bounds[1])

        return Command(
            opening=limit(wanted.opening, last.opening, self.speed, self.opening),
            force_limit=min(max(wanted.force_limit, 0.0), self.force),
            lift_height=limit(wanted.lift_height, last.lift_height, self.lift_speed, self.lift),
            phase=wanted.phase,
            memory=wanted.memory,
            reason=wanted.reason,
        )
