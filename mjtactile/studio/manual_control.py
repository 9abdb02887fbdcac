"""Manual control of the gripper: `ManualControl` executes the controller or a manual goal.

Commands of both pass the supervisor and the rig's limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from mjtactile.core.types import Command, Observation
from mjtactile.runtime.controller import LoadedController

# speeds, m/s
_OPENING_SPEED = 0.03
_LIFT_SPEED = 0.04
# gain, m/s per N of force error, and speed limit, m/s: as in the included controller
_SQUEEZE_GAIN = 0.03
_SQUEEZE_SPEED = 0.01
_LEAD_MAX = 4e-3  # maximum distance of the commanded opening from the jaws during squeezing, m
_SERVO_FORCE = 4.0  # force limit of the servo, N


@dataclass(frozen=True)
class ManualGoal:
    """Target opening and lift height, m.

    A finite `force`, N, is the target of the measured grip force and replaces the opening. NaN
    means that the opening applies.
    """

    opening: float
    lift_height: float
    force: float = math.nan

    def command(self, observation: Observation) -> Command:
        """Return one cycle's step to the goal, with the phase and memory of the controller."""
        last = observation.command
        period = observation.period
        return replace(
            last,
            opening=self._opening(observation),
            force_limit=_SERVO_FORCE,
            lift_height=_towards(last.lift_height, self.lift_height, _LIFT_SPEED * period),
        )

    def _opening(self, observation: Observation) -> float:
        last = observation.command.opening
        period = observation.period
        actual = observation.gripper.opening
        if not math.isfinite(self.force):
            return _towards(last, self.opening, _OPENING_SPEED * period)
        estimated = sum(touch.force_normal for touch in observation.touch) / len(observation.touch)
        if not math.isfinite(estimated):
            return last
        touching = any(touch.touching for touch in observation.touch)
        maximum = _SQUEEZE_SPEED if touching else _OPENING_SPEED
        speed = _SQUEEZE_GAIN * (self.force - estimated) if touching else maximum
        requested = last - max(-maximum, min(maximum, speed)) * period
        if math.isfinite(actual):
            return max(actual - _LEAD_MAX, min(actual + _LEAD_MAX, requested))
        return requested


def _towards(start: float, goal: float, maximum: float) -> float:
    return start + max(-maximum, min(maximum, goal - start))


class ManualControl:
    """A controller that does not run while there is a `manual_goal`."""

    def __init__(self, controller: LoadedController):
        self._controller = controller
        self.reads = getattr(controller, "reads", ())
        self.manual_goal: ManualGoal | None = None

    @property
    def path(self) -> Path:
        return self._controller.path

    def step(self, observation: Observation) -> Command:
        manual_goal = self.manual_goal
        if manual_goal is None:
            return self._controller.step(observation)
        return manual_goal.command(observation)
