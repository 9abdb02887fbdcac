"""Conversions between servo angle and jaw opening, and from current to force at the jaw.

Each jaw servo moves a part of the gripper's opening by a law of `mjtactile.rig.jaw_transmission`.
Jaws coupled by a gear, or in contact with one object, have equal forces. If each servo moves its
finger's half, the force on each finger is the mean over the servos. If one servo moves the whole
opening, it is that servo's force.
"""

from __future__ import annotations

import math

from mjtactile.core.errors import InputError
from mjtactile.devices.dynamixel.servo_models import MODELS, TICKS_PER_RAD, ServoModel
from mjtactile.rig.file import GripperConfig, ServoConfig
from mjtactile.rig.jaw_transmission import LINEAR, JawLaw, make_law

_REVOLUTION_TICKS = 4096
_LIMIT_SAMPLES = 32


class JawServo:
    """Units of one jaw servo. Raises InputError if its law cannot be inverted or its model is
    unknown."""

    def __init__(self, config: ServoConfig, source: str):
        self.config = config
        self.model: ServoModel = find_model(config.model, source, "gripper.servo.model")
        self.torque_per_A = config.torque_per_A or self.model.torque_per_A
        self.revolution_offset_ticks = 0  # whole turns that were lost when the power was off
        self.law = _law(config, source)

    def part(self, ticks: float) -> float:
        """Return this servo's part of the opening, m, at a present position."""
        return self.law.part(self._angle(ticks))

    def ticks(self, part: float) -> int:
        """Return the goal position nearest to a part of the opening in the range of the law."""
        return (
            round(self.config.zero_ticks + self.law.coordinate(part) * TICKS_PER_RAD)
            - self.revolution_offset_ticks
        )

    def slope(self, ticks: float) -> float:
        """Return the opening per servo angle, m/rad, at a present position."""
        return self.law.slope(self._angle(ticks))

    def closing_force(self, current: float, ticks: float) -> float:
        """Return the force, N, with which `current`, A, closes this servo's jaw."""
        return -current * self.torque_per_A / self.slope(ticks)

    def current_units(self, force: float, ticks: float) -> int:
        """Return the goal current of `force` N in model units: 0, or 1 to the model's limit."""
        if force == 0:
            return 0
        ampere = abs(force * self.slope(ticks)) / self.torque_per_A
        return int(
            min(
                max(math.floor(ampere / self.model.ampere_per_unit), 1),
                self.model.current_max_units,
            )
        )

    def current_limit(self, force: float, low: float, high: float) -> int:
        """Return the maximum of `current_units` over the jaw range [`low`, `high`] m."""
        parts = (low + (high - low) * i / _LIMIT_SAMPLES for i in range(_LIMIT_SAMPLES + 1))
        return max(self.current_units(force, self.ticks(part)) for part in parts)

    def set_revolution_offset(self, ticks: int, low: float, high: float) -> None:
        """Find the turn in which the jaw is within [`low`, `high`] m.

        After power-up a servo reports its angle within one turn only. Raises ValueError if no turn
        or several turns fit.
        """
        self.revolution_offset_ticks = 0
        margin = 0.02 * (high - low) + 0.001
        fits = []
        for rotation in (-1, 0, 1):
            self.revolution_offset_ticks = rotation * _REVOLUTION_TICKS
            if low - margin <= self.part(ticks) <= high + margin and self.law.is_reachable(
                self._angle(ticks)
            ):
                fits.append(rotation)
        self.revolution_offset_ticks = 0
        if len(fits) != 1:
            raise ValueError("no" if not fits else "more than one")
        self.revolution_offset_ticks = fits[0] * _REVOLUTION_TICKS

    def _angle(self, ticks: float) -> float:
        return (ticks + self.revolution_offset_ticks - self.config.zero_ticks) / TICKS_PER_RAD


class JawGeometry:
    """All jaw servos of a gripper together; `opening` is the sum of their parts."""

    def __init__(self, config: GripperConfig, source: str):
        self.config = config
        self.servos = tuple(JawServo(servo, source) for servo in config.servos)

    def opening(self, ticks: dict[int, int]) -> float:
        return sum(servo.part(ticks[servo.config.id]) for servo in self.servos)

    def speed(self, ticks: dict[int, int], rad_per_s: dict[int, float]) -> float:
        return sum(
            servo.slope(ticks[servo.config.id]) * rad_per_s[servo.config.id]
            for servo in self.servos
        )

    def effort(self, ticks: dict[int, int], current: dict[int, float]) -> float:
        """Compute the closing force on each finger from the currents, N."""
        forces = [
            servo.closing_force(current[servo.config.id], ticks[servo.config.id])
            for servo in self.servos
        ]
        return sum(forces) / len(forces)

    def goals(
        self, opening: float, ticks: dict[int, int] | None = None, lead: float = math.inf
    ) -> dict[int, int]:
        """Return the goal positions for an opening, divided equally among the jaws.

        While closing, `lead`, m, is divided equally too. Each jaw's goal is at most that far ahead
        of its current position (`ticks`).
        """
        fraction = opening / len(self.servos)
        lead = lead / len(self.servos)
        return {
            servo.config.id: servo.ticks(
                max(fraction, servo.part(ticks[servo.config.id]) - lead) if ticks else fraction
            )
            for servo in self.servos
        }


def find_model(name: str, source: str, field: str) -> ServoModel:
    """Return the servo model of that name. Raises InputError with the choices."""
    if name not in MODELS:
        raise InputError(
            f"{name!r} is unknown or cannot limit its force",
            source=source,
            field=field,
            choices=MODELS,
        )
    return MODELS[name]


def _law(config: ServoConfig, source: str) -> JawLaw:
    try:
        return make_law(
            LINEAR if config.transmission == "rack" else config.transmission,
            config.opening_part,
            config.per_rad,
            config.table,
        )
    except ValueError as error:
        field = "table_deg_mm" if config.transmission == "table" else "mm_per_rad"
        raise InputError(str(error), source=source, field=f"gripper.servo.{field}") from error
