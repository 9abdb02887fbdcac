"""`PlayCompensation`: goals of motors that compensate the gear play of jaws.

Model of `mjtactile calibrate gripper`: the jaws lag the motors by half of the play. At a reversal
the motors therefore move by the whole play at once.
"""

from __future__ import annotations

import math

_REVERSAL = 0.25  # minimum reversal, as a fraction of the play: noise does not rattle the gears


class PlayCompensation:
    """Compensation of a measured `play` m of the opening; 0 leaves everything unchanged."""

    def __init__(self, play: float):
        self._half = play / 2
        self._tolerance = _REVERSAL * play
        self._jaws = math.nan
        self._motors = math.nan

    def motor_goal(self, opening: float) -> float:
        """Return the goal of the motors, m, for a goal of the jaws' `opening`, m."""
        moved = opening - self._jaws
        if math.isnan(moved):
            self._jaws, self._motors = opening, opening
        elif abs(moved) > self._tolerance or moved * (self._motors - self._jaws) > 0:
            self._jaws = opening
            self._motors = opening + math.copysign(self._half, moved)
        return self._motors

    def opening(self, motors: float) -> float:
        """Return the opening of the jaws, m, for a measured opening of the `motors`, m."""
        offset = self._motors - self._jaws
        return motors if math.isnan(offset) else motors - offset
