"""Coupling of the emulated servo shafts to the jaws: the mechanics of a rig file's `law`.

The code is independent of the driver's geometry. A wrong sign or factor there shows as a wrong
opening or force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mjtactile.core.errors import InputError
from mjtactile.emulator.servo import EmulatedServo
from mjtactile.rig.file import ServoConfig

_TICK = 2 * math.pi / 4096  # rad


class Jaw:
    """One servo's shaft and its part x, m, of the opening.

    On a rack, x = x0 + r a. On a crank, x = x0 + r sin a.
    """

    def __init__(self, servo: EmulatedServo, config: ServoConfig, source: str):
        if config.transmission not in ("rack", "crank"):
            raise InputError(
                "the emulator does not support this mechanism",
                source=source,
                field="gripper.servo.transmission",
                choices=("rack", "crank"),
            )
        self.servo = servo
        self._config = config
        self._zero = config.zero_ticks * _TICK

    def angle(self, part: float) -> float:
        ratio = (part - self._config.opening_part) / self._config.per_rad
        if self._config.transmission == "crank":
            ratio = math.asin(max(-1.0, min(1.0, ratio)))
        return self._zero + ratio

    def part(self, angle: float) -> float:
        swing = angle - self._zero
        if self._config.transmission == "crank":
            swing = math.sin(max(-math.pi / 2, min(math.pi / 2, swing)))
        return self._config.opening_part + self._config.per_rad * swing

    def lever(self, angle: float) -> float:
        """Return the local opening part per shaft angle, m/rad: torque over force, by virtual
        work."""
        if self._config.transmission == "crank":
            return self._config.per_rad * max(0.02, math.cos(angle - self._zero))
        return self._config.per_rad


class GearedJaws:
    """All jaws; a gear keeps them symmetric, so that each has the same part of the opening.

    `backlash` is the lost motion between shafts and jaws, m of the opening.
    """

    def __init__(self, jaws: Sequence[Jaw], backlash: float = 0.0):
        self._jaws = tuple(jaws)
        self._play = backlash / 2

    def drive(self, opening: float) -> tuple[float | None, float]:
        """Return the goal opening of the jaws, m, and the servos' joint force limit per finger, N.

        The jaws are at `opening` m. The goal is None if no servo has torque.
        """
        drives = [(jaw, jaw.servo.drive()) for jaw in self._jaws]
        on = [(jaw, drive) for jaw, drive in drives if drive.torque_max > 0]
        if not on:
            return None, 0.0
        parts = [jaw.part(drive.goal) for jaw, drive in on]
        forces = [drive.torque_max / abs(jaw.lever(jaw.servo.angle)) for jaw, drive in on]
        goal = sum(parts) / len(on) * len(self._jaws)
        return goal - self._slack(goal, opening), sum(forces) / len(self._jaws)

    def _slack(self, goal: float, opening: float) -> float:
        """Return the lead of the shafts over the jaws on the path to `goal`, m of opening."""
        return min(max(goal - opening, -self._play), self._play)

    def follow_load(self, opening: float, speed: float, force: float, period: float) -> None:
        """Rotate the shafts to the jaws' positions. The driving servos share the closing `force`,
        N, on each finger equally."""
        on = [jaw for jaw in self._jaws if jaw.servo.drive().torque_max > 0]
        count = len(self._jaws)
        for jaw in self._jaws:
            part = opening / count
            if jaw in on and self._play:
                part += self._slack(count * jaw.part(jaw.servo.drive().goal), opening) / count
            angle = jaw.angle(part)
            lever = jaw.lever(angle)
            torque = -force * count / len(on) * lever if jaw in on else 0.0
            jaw.servo.follow_load(angle, speed / count / lever, torque, period)
