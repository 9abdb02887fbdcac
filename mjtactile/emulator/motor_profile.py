"""Motor of an emulated servo: the path of its profile, and the drive that its mode requests.

Sources: "What is the Profile", "Profile Velocity(112)", "Profile Acceleration(108)" of each model's
e-manual page.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

FAR = 2 * math.pi  # rad ahead: where a motor without a position goal pulls to


@dataclass(frozen=True)
class MotorDrive:
    """Current motor drive: goal angle, rad (turns counted), and torque limit, N m (0: no
    torque)."""

    goal: float
    torque_max: float


@dataclass
class Path:
    """Trajectory of a profile to a goal: `angle`, rad, and `speed`, rad/s."""

    angle: float
    speed: float = 0.0
    origin: float = 0.0  # last position at rest

    def start(self, angle: float) -> None:
        """Set the position to `angle` with zero speed."""
        self.angle = angle
        self.speed = 0.0
        self.origin = angle

    def follow(self, goal: float, speed_max: float, acceleration: float, period: float) -> None:
        """Move towards a position; 0 is no limit (`speed_max` 0: a step, at any acceleration)."""
        left = goal - self.angle
        if speed_max <= 0:
            self.start(goal)
            return
        requested = math.copysign(speed_max, left) if left else 0.0
        if acceleration > 0:
            requested = math.copysign(min(speed_max, math.sqrt(2 * acceleration * abs(left))), left)
            change = acceleration * period
            requested = self.speed + min(max(requested - self.speed, -change), change)
        step = requested * period
        if abs(step) >= abs(left) and step * left >= 0:
            self.start(goal)
        else:
            self.angle = self.angle + step
            self.speed = requested

    def turn(self, speed: float, acceleration: float, period: float) -> None:
        """Move for one period, s, with a speed that approaches `speed`, rad/s."""
        change = acceleration * period if acceleration > 0 else math.inf
        self.speed += min(max(speed - self.speed, -change), change)
        self.angle += self.speed * period
