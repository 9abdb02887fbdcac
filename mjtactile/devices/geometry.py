"""From servo angle to jaw opening and back, and from current to force at the jaw.

Each jaw servo owns a part x_i of the gripper's opening, x_i(angle) by one of three laws:

- rack: x = x0 + r a, with r m/rad of the pinion;
- crank: x = x0 + r sin a, with the crank's length r m (a parallel linkage; |a| < 90 degrees);
- table: measured pairs (a, x), strictly monotonic in both, linear between.

By virtual work the servo's torque tau gives the force f = -tau / (dx/da) that closes the jaws. Jaws that a gear keeps
symmetric, or that squeeze one object, share: the force on each finger is the mean over the servos when each owns its
finger's half, and the single servo's f when one servo owns the whole opening.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from mjtactile.devices.dynamixel_tables import MODELS, TICKS_PER_RAD, ServoModel
from mjtactile.errors import InputError
from mjtactile.rigfile import GripperConfig, ServoConfig

_TURN_TICKS = 4096


class JawServo:
    """Units of one jaw servo. Raises InputError when its law cannot be inverted or its model is not known."""

    def __init__(self, config: ServoConfig, source: str):
        self.config = config
        self.model: ServoModel = find_model(config.model, source, "gripper.servo.model")
        self.torque_per_A = config.torque_per_A or self.model.torque_per_A
        self.turn_offset_ticks = 0  # whole turns that were lost when the power was off
        if config.law == "table":
            self._angles, self._parts = _monotonic_table(config, source)
        elif config.per_rad == 0:
            raise InputError("0 moves nothing", source=source, field="gripper.servo.mm_per_rad")

    def part(self, ticks: float) -> float:
        """This servo's part of the opening, m, at a present position."""
        angle = (ticks + self.turn_offset_ticks - self.config.zero_ticks) / TICKS_PER_RAD
        if self.config.law == "table":
            return float(np.interp(angle, self._angles, self._parts))
        if self.config.law == "crank":
            return self.config.opening_part + self.config.per_rad * math.sin(max(-math.pi / 2, min(math.pi / 2, angle)))
        return self.config.opening_part + self.config.per_rad * angle

    def ticks(self, part: float) -> int:
        """The goal position for a part of the opening; the nearest that the law reaches."""
        if self.config.law == "table":
            order = np.argsort(self._parts)
            angle = float(np.interp(part, self._parts[order], self._angles[order]))
        else:
            angle = (part - self.config.opening_part) / self.config.per_rad
            if self.config.law == "crank":
                angle = math.asin(max(-1.0, min(1.0, angle)))
        return round(self.config.zero_ticks + angle * TICKS_PER_RAD) - self.turn_offset_ticks

    def slope(self, ticks: float) -> float:
        """dx/da, m/rad, at a present position; never below a hundredth of its size, where a crank is at its end."""
        if self.config.law == "rack":
            return self.config.per_rad
        angle = (ticks + self.turn_offset_ticks - self.config.zero_ticks) / TICKS_PER_RAD
        if self.config.law == "crank":
            cosine = max(math.cos(angle), 0.01)
            return self.config.per_rad * cosine
        low = int(np.clip(np.searchsorted(self._angles, angle) - 1, 0, len(self._angles) - 2))
        return float((self._parts[low + 1] - self._parts[low]) / (self._angles[low + 1] - self._angles[low]))

    def closing_force(self, current: float, ticks: float) -> float:
        """Force with which `current` A closes this servo's jaw, N."""
        return -current * self.torque_per_A / self.slope(ticks)

    def current_units(self, force: float, ticks: float) -> int:
        """Goal current, in the model's units, that gives `force` N at the jaw; at least 1, at most the model's limit."""
        ampere = abs(force * self.slope(ticks)) / self.torque_per_A
        return int(min(max(math.floor(ampere / self.model.ampere_per_unit), 1), self.model.current_max_units))

    def set_turn_offset(self, ticks: int, low: float, high: float) -> None:
        """After power-up a servo knows its angle within one turn only: find the turn in which its jaw is within
        [`low`, `high`] m. Raises ValueError when none or several are."""
        self.turn_offset_ticks = 0
        margin = 0.02 * (high - low) + 0.001
        fits = []
        for turn in (-1, 0, 1):
            self.turn_offset_ticks = turn * _TURN_TICKS
            angle = (ticks + self.turn_offset_ticks - self.config.zero_ticks) / TICKS_PER_RAD
            if low - margin <= self.part(ticks) <= high + margin and self._on_law(angle):
                fits.append(turn)
        self.turn_offset_ticks = 0
        if len(fits) != 1:
            raise ValueError("no" if not fits else "more than one")
        self.turn_offset_ticks = fits[0] * _TURN_TICKS

    def _on_law(self, angle: float) -> bool:
        if self.config.law == "crank":
            return abs(angle) <= math.pi / 2 + 0.05
        if self.config.law == "table":
            slack = 0.05 * (self._angles[-1] - self._angles[0])
            return bool(self._angles[0] - slack <= angle <= self._angles[-1] + slack)
        return True


class JawGeometry:
    """All jaw servos of a gripper together; `opening` is the sum of their parts."""

    def __init__(self, config: GripperConfig, source: str):
        self.config = config
        self.servos = tuple(JawServo(servo, source) for servo in config.servos)

    def opening(self, ticks: dict[int, int]) -> float:
        return sum(servo.part(ticks[servo.config.id]) for servo in self.servos)

    def speed(self, ticks: dict[int, int], rad_per_s: dict[int, float]) -> float:
        return sum(servo.slope(ticks[servo.config.id]) * rad_per_s[servo.config.id] for servo in self.servos)

    def effort(self, ticks: dict[int, int], current: dict[int, float]) -> float:
        """Closing force on each finger, N, as the currents say."""
        forces = [servo.closing_force(current[servo.config.id], ticks[servo.config.id]) for servo in self.servos]
        return sum(forces) / len(forces)

    def goals(self, opening: float) -> dict[int, int]:
        """Goal positions for an opening, shared equally."""
        share = opening / len(self.servos)
        return {servo.config.id: servo.ticks(share) for servo in self.servos}


def find_model(name: str, source: str, field: str) -> ServoModel:
    """The model of that name. Raises InputError with the choices."""
    if name not in MODELS:
        raise InputError(f"{name!r} cannot limit its force or is not known", source=source, field=field, choices=MODELS)
    return MODELS[name]


def _monotonic_table(config: ServoConfig, source: str) -> tuple[np.ndarray, np.ndarray]:
    angles, parts = (np.array(column) for column in zip(*config.table, strict=True)) if config.table else ([], [])
    rises = {b > a for a, b in pairwise(parts)}
    if len(angles) < 2 or any(b <= a for a, b in pairwise(angles)) or len(rises) != 1 or len(set(parts)) != len(parts):
        raise InputError("needs at least two pairs, angles rising, openings rising or falling throughout", source=source,
                         field="gripper.servo.table_deg_mm")
    return np.asarray(angles, float), np.asarray(parts, float)
