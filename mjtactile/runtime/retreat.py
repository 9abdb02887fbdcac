"""Retreat to the safe state: lower the gripper until the held object stands, then open, both
slowly.

Each step starts from measured values. The end is verified by measurement: the jaws are open, or no
finger is in contact. A command alone verifies neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from mjtactile.core.types import Command, Touch
from mjtactile.runtime.set_down import HEIGHT_TOLERANCE, SuspendedLoad

RETREAT_SPEED = 0.030  # speed of opening and lowering, m/s
RETREAT_OPENING = 0.015  # additional opening, m: it releases an object without throwing it
RETREAT_FORCE = 4.0  # minimum force limit of the servo for opening, N
# Minimum time limit of lowering, s, counted in periods. Lowering 0.1 m takes 3.3 s, or longer if
# the loop is late or was stopped.
RETREAT_TIME_MAX = 5.0
# time limit of opening, s; it takes 0.5 s plus the time for the goal to reach the jaws
OPEN_TIME_MAX = 3.0
# Height tolerance, m, and time limit, s: a gripper above its goal first completes its motion,
# unless an obstacle blocks it
_DOWN = 1e-3
_DOWN_TIME_MAX = 1.0
_OPEN_SLACK = 2e-3  # tolerance of the measured opening, m: backlash and a compliant servo
# tolerance, m: a servo's goal is rounded to 0.02 to 0.1 mm
OPENING_TOLERANCE = 2e-4


def may_hold(touch: Touch) -> bool:
    """Return True if the finger is in contact, or its contact is unknown."""
    return touch.touching or not math.isfinite(touch.force_normal)


class Retreat:
    """Retreat of one run to the safe state.

    `next` is called once per cycle. Afterwards, `unverified` describes the unverified part, or is
    empty.
    """

    def __init__(self, period: float):
        self._period = period
        self._load = SuspendedLoad()
        self._stands = False
        self._lowering_time = self._down_time = self._open_time = 0.0
        self._lowering_time_max = RETREAT_TIME_MAX
        self._measured: float | None = None  # last known opening, m
        self._goal: float | None = None  # goal of the opening, m; None: the gripper is not down yet
        self._opening = 0.0  # commanded opening, m, once there is a goal
        self._before: float | None = None  # previously commanded opening, m
        self.unverified = ""

    def watch(self, touch: Sequence[Touch], height: float) -> None:
        """Store the load on the fingers before the retreat, at `height`, m."""
        self._load.note(touch, height)

    def next(
        self, last: Command, touch: Sequence[Touch], opening: float | None, height: float | None
    ) -> Command | None:
        """Return the next command; None: it is over.

        `opening` and `height`, m, are measured (None: unknown).
        """
        if opening is not None:
            self._measured = opening
        return self._lowering_command(last, touch, height) or self._open(last, touch, opening)

    def _lowering_command(
        self, last: Command, touch: Sequence[Touch], height: float | None
    ) -> Command | None:
        """Return the next lowering command; None: the gripper is down, or the held object
        stands."""
        self._stands |= self._load.stands(touch, last.lift_height)
        if self._lowering_time == 0:
            time = 1.5 * last.lift_height / RETREAT_SPEED
            self._lowering_time_max = max(RETREAT_TIME_MAX, time)
        in_time = self._lowering_time < self._lowering_time_max
        self._lowering_time += self._period
        if last.lift_height > HEIGHT_TOLERANCE and not self._stands and in_time:
            step = RETREAT_SPEED * self._period
            return replace(last, lift_height=max(0.0, last.lift_height - step))
        self._down_time += self._period
        is_above = height is not None and height > last.lift_height + _DOWN
        if is_above and self._down_time < _DOWN_TIME_MAX:
            return last  # the lift is still moving, after a stop or since it is slow
        return None

    def _open(self, last: Command, touch: Sequence[Touch], opening: float | None) -> Command | None:
        """Return the next opening command; None: the opening is verified, or took too long."""
        if self._goal is None:
            self._opening = last.opening if self._measured is None else self._measured
            self._goal = self._opening + RETREAT_OPENING
        elif last.opening == self._before:
            self._goal = min(self._goal, last.opening)  # the rig opens no further
        self._before = last.opening
        if self._is_safe(last, touch, opening, self._goal):
            return None
        if self._open_time > OPEN_TIME_MAX:
            self.unverified = _measured_text(touch, opening, self._goal)
            return None
        self._open_time += self._period
        self._opening = min(self._goal, self._opening + RETREAT_SPEED * self._period)
        return replace(
            last, opening=max(self._opening, last.opening), force_limit=self._force(last)
        )

    def _is_safe(
        self, last: Command, touch: Sequence[Touch], opening: float | None, goal: float
    ) -> bool:
        if last.opening < goal - OPENING_TOLERANCE:
            return False
        is_free = bool(touch) and not any(map(may_hold, touch))
        return is_free or (opening is not None and opening >= goal - _OPEN_SLACK)

    def _force(self, last: Command) -> float | None:
        """Return the force limit, N, at least RETREAT_FORCE once the goal opens the jaws."""
        if self._measured is None or last.opening < self._measured:
            return last.force_limit
        return max(last.force_limit or 0.0, RETREAT_FORCE)


def _measured_text(touch: Sequence[Touch], opening: float | None, goal: float) -> str:
    """Return the measured values of a gripper that is not verified open, as text."""
    jaws = "the opening is unknown"
    if opening is not None:
        jaws = f"the jaws are at {1e3 * opening:.1f} mm instead of {1e3 * goal:.1f} mm"
    forces = [
        f"{estimate.force_normal:.2f} N" if math.isfinite(estimate.force_normal) else "unknown"
        for estimate in touch
    ]
    return f"{jaws}, the forces are {', '.join(forces)}" if forces else jaws
