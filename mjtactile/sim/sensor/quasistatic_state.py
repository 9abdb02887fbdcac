"""`QuasistaticState`: what a film's kernel remembers from look to look, by name."""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneStatus

# places, as kernels/qs_friction.h has them
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
    """One film's. SI units, frame S.

    Attributes:
        numbers: (69,) that the kernel reads and writes.
    """

    def __init__(self) -> None:
        self.numbers = np.zeros(_COUNT)

    def forget(self) -> None:
        """Be as before the first look."""
        self.numbers[:] = 0.0

    @property
    def is_touched(self) -> bool:
        """Whether anything touches the film."""
        return bool(self.numbers[_BODY] > 0)

    @property
    def near(self) -> int:
        """How many bodies are near."""
        return int(self.numbers[_NEAR])

    @property
    def wrench(self) -> Array:
        """(6,) N and N m about the origin of S that the world exerts on the film."""
        return self.numbers[_WRENCH].copy()

    @property
    def middle(self) -> Array:
        """(3,) m, where what touches presses on the whole."""
        return self.numbers[_MIDDLE].copy()

    @property
    def radius(self) -> float:
        """m, the mean distance of what presses from that, in the frame's plane; 0: nothing
        does."""
        return float(self.numbers[_RADIUS])

    @property
    def strain(self) -> Array:
        """(3,) m, m and rad that what sticks has dragged and turned the sheet."""
        return self.numbers[_STRAIN].copy()

    @property
    def slides(self) -> bool:
        """Whether what touches is at friction's limit."""
        return bool(self.numbers[_SLIDES])

    @property
    def slid(self) -> float:
        """m that what touches has slid over the film since it touched."""
        return float(self.numbers[_SLID])

    @property
    def status(self) -> MembraneStatus:
        """How the last solution ended."""
        return MembraneStatus(int(self.numbers[_STATUS]))

    @property
    def lost(self) -> int:
        """Steps without a solution in a row."""
        return int(self.numbers[_LOST])

    def lose(self) -> None:
        """Count one more step without a solution."""
        self.numbers[_LOST] += 1

    def rest_at(self, gauge_pressure: float) -> None:
        """Take the film as solved for, at a pressure, Pa, that is held."""
        self.numbers[_SOLVED_GAS] = gauge_pressure, 0.0
