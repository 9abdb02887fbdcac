"""How stiff a grip is: what the jaws must move by for a force."""

from __future__ import annotations

import math
from dataclasses import dataclass

# Two membranes over 1 kPa about a ball: N/m of opening, and N/m for each N on a finger (measured in
# simulation, docs/how-to/controllers.md); a flat face is some three times as hard
_SOFT = 110.0
_STIFF = 260.0
_UNKNOWN = 1.5  # times as hard, until it is measured: too short a step is made good
_WAY_MIN = 3e-4  # m of a ball's way, and of the jaws: backlash is 0.1-0.2 mm
_SETTLING = 0.15  # s over which it is averaged
_RANGE = (0.4, 6.0)


@dataclass(frozen=True)
class GripStiffnessEstimator:
    """A controller keeps it as numbers (`vars`) and takes it up again
    (`GripStiffnessEstimator(**kept)`).

    Attributes:
        opening: m, of the jaws when all fingers touched; negative: not yet.
        force: N, the mean of the fingers then.
        hardness: Times as stiff as a ball between two membranes.
    """

    opening: float = -1.0
    force: float = 0.0
    hardness: float = _UNKNOWN

    def stiffness(self, force: float) -> float:
        """Say how much the force on each finger grows with the jaws' way.

        Args:
            force: N on each finger.

        Returns:
            N/m of opening.
        """
        return self.hardness * (_SOFT + _STIFF * max(force, 0.0))

    def after(self, opening: float, force: float, period: float) -> GripStiffnessEstimator:
        """Take in one image, from when all fingers touch.

        Args:
            opening: m, of the jaws.
            force: N, the mean of the fingers.
            period: s since the image before.

        Returns:
            What is known now.
        """
        if self.opening < 0:
            return GripStiffnessEstimator(opening, force)
        nominal = _way(force) - _way(self.force)
        way = self.opening - opening
        if min(nominal, 2 * way) < _WAY_MIN:
            return self
        found = min(max(nominal / way, _RANGE[0]), _RANGE[1])
        share = min(1.0, period / _SETTLING)
        return GripStiffnessEstimator(
            self.opening, self.force, self.hardness + share * (found - self.hardness)
        )


def _way(force: float) -> float:
    """m from the first touch of a ball to `force` N, of a spring that gets harder with it."""
    return math.log1p(_STIFF * max(force, 0.0) / _SOFT) / _STIFF
