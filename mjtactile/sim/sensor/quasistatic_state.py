"""`QuasistaticState`: named access to the kernel state of a quasi-static membrane."""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneStatus

# indices, as in kernels/qs_friction.h
_COUNT = 69
_BODY = 0
_WRENCH = slice(1, 7)
_MIDDLE = slice(7, 10)
_RADIUS = 10
_SLIDES = 11
_STRAIN = slice(12, 15)
_NEAR = 18
_STATUS = 19
_LOST = 20
_SOLVED_GAS = slice(57, 59)
_SLID = 66


class QuasistaticState:
    """State of one quasi-static membrane in `numbers` (69,), which the kernel writes. SI units,
    frame S."""

    def __init__(self) -> None:
        self.numbers = np.zeros(_COUNT)

    def forget(self) -> None:
        """Reset the state to that before the first update."""
        self.numbers[:] = 0.0

    @property
    def is_touched(self) -> bool:
        """True if an obstacle touches the membrane."""
        return bool(self.numbers[_BODY] > 0)

    @property
    def near(self) -> int:
        """Number of near obstacles."""
        return int(self.numbers[_NEAR])

    @property
    def wrench(self) -> Array:
        """Wrench (6,) N and N m of the obstacles on the membrane, about the origin of S."""
        return self.numbers[_WRENCH].copy()

    @property
    def middle(self) -> Array:
        """Center of pressure (3,), m."""
        return self.numbers[_MIDDLE].copy()

    @property
    def radius(self) -> float:
        """Mean distance of the contact pressure from `middle`, m; 0 without contact."""
        return float(self.numbers[_RADIUS])

    @property
    def strain(self) -> Array:
        """Shear displacement along x, y and rotation (3,) of the sticking membrane, m, m, rad."""
        return self.numbers[_STRAIN].copy()

    @property
    def slides(self) -> bool:
        """True if the contact is at the friction limit."""
        return bool(self.numbers[_SLIDES])

    @property
    def slid(self) -> float:
        """Sliding distance of the obstacle over the membrane since first touch, m."""
        return float(self.numbers[_SLID])

    @property
    def status(self) -> MembraneStatus:
        """Status of the last solution."""
        return MembraneStatus(int(self.numbers[_STATUS]))

    @property
    def lost(self) -> int:
        """Steps without a solution in a row."""
        return int(self.numbers[_LOST])

    def lose(self) -> None:
        """Count one more step without a solution."""
        self.numbers[_LOST] += 1

    def rest_at(self, gauge_pressure: float) -> None:
        """Mark the membrane as solved at a constant gauge pressure, Pa."""
        self.numbers[_SOLVED_GAS] = gauge_pressure, 0.0
