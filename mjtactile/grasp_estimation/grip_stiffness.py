"""Grip stiffness: change of the grip force per change of the opening."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mjtactile.core.signature_checks import not_below, validated

# Two membranes at 1 kPa around a ball: stiffness, N/m of opening, and its increase with the force
# on a finger, 1/m (measured in simulation, docs/how-to/controllers.md); a flat face is about three
# times as stiff
_SOFT = 110.0
_STIFF = 260.0
_UNKNOWN = 1.5  # times as hard, until it is measured: too short a step is made good
_WAY_MIN = 3e-4  # minimum closing distance for a ball, and of the jaws, m: backlash is 0.1-0.2 mm
_SETTLING = 0.15  # averaging time, s
_RANGE = (0.4, 6.0)


@dataclass(frozen=True)
class GripStiffnessEstimator:
    """Recursive estimator of the grip stiffness.

    A controller stores it as plain values (`vars`) and restores it
    (`GripStiffnessEstimator(**kept)`).

    Attributes:
        opening: Opening of the jaws at the first contact of all fingers, m; negative: no contact
            yet.
        force: Mean force of the fingers at that contact, N.
        hardness: Stiffness relative to that of a ball between two membranes.
    """

    opening: float = -1.0
    force: float = 0.0
    hardness: float = _UNKNOWN

    @validated()
    def stiffness(self, force: float) -> float:
        """Return the change of each finger's force per change of the opening.

        Args:
            force: Force on each finger, N.

        Returns:
            Stiffness, N/m of opening.
        """
        return self.hardness * (_SOFT + _STIFF * max(force, 0.0))

    @validated()
    def way(self, start: float, end: float) -> float:
        """Return the closing distance that changes each finger's force, m.

        Args:
            start: Initial force on each finger, N.
            end: Final force, N.

        Returns:
            Decrease of the opening; negative for a smaller force.
        """
        return (_way(end) - _way(start)) / self.hardness

    @validated(period=not_below(0))
    def after(self, opening: float, force: float, period: float) -> GripStiffnessEstimator:
        """Update with one image, from the contact of all fingers on.

        Args:
            opening: Opening of the jaws, m.
            force: Mean force of the fingers, N.
            period: Time since the previous image, s.

        Returns:
            The updated estimator.
        """
        if self.opening < 0:
            return GripStiffnessEstimator(opening, force)
        nominal = _way(force) - _way(self.force)
        compression = self.opening - opening
        if min(nominal, 2 * compression) < _WAY_MIN:
            return self
        found = min(max(nominal / compression, _RANGE[0]), _RANGE[1])
        fraction = min(1.0, period / _SETTLING)
        return GripStiffnessEstimator(
            self.opening, self.force, self.hardness + fraction * (found - self.hardness)
        )


def _way(force: float) -> float:
    """Return the closing distance from first contact with a ball to `force` N, m.

    The ball acts as a stiffening spring.
    """
    return math.log1p(_STIFF * max(force, 0.0) / _SOFT) / _STIFF
