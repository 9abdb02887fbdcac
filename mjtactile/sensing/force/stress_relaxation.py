"""Rubber that relaxes, as sensing knows it: what `mjtactile.core.relaxation` says, at the Gauss
points of the inverse's sheet. For sensing; the simulator has code of its own.

The shape that was found tells the stress S at every point, and from one image to the next each term
gives up what that stress makes it give up (Eq. F23). What has faded is a load on the sheet like any
other; without it, it would be felt as force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.relaxation import Relaxation
from mjtactile.core.types import Array
from mjtactile.sensing.force.spline_fem import Sheet


@dataclass(frozen=True, eq=False)
class RelaxationState:
    """What each term has given up, `faded` (terms, 3, qx, qy) N/m, with the lasting `stress` (3,
    qx, qy) N/m at `time` s."""

    faded: Array
    stress: Array
    time: float

    @property
    def total(self) -> Array:
        """(3, qx, qy) N/m that all terms together have given up."""
        return self.faded.sum(axis=0)


class RelaxingMembrane:
    """Follows what the rubber of one sensor's sheet gives up; `scale` is that of its lasting
    modulus, as in `InverseRest`."""

    def __init__(self, sheet: Sheet, relaxation: Relaxation):
        self._sheet = sheet
        self._relaxation = relaxation
        self._shares = relaxation.shares[:, None, None, None]

    def begin(self, c: Array, scale: float, inflated_s: float, time: float) -> RelaxationState:
        """Of a sheet that was flat for ever and then at `c` (3, n) m for `inflated_s` s, up to
        `time` s."""
        flat = scale * self._sheet.stress(np.zeros_like(c))
        stress = scale * self._sheet.stress(c)
        kept = self._kept(inflated_s)
        return RelaxationState(self._shares * (kept * flat + (1 - kept) * stress), stress, time)

    def after(
        self, memory: RelaxationState, c: Array, scale: float, time: float
    ) -> RelaxationState:
        """What it remembers at `time` s, when it is at `c` (3, n) m."""
        stress = scale * self._sheet.stress(c)
        kept = self._kept(max(time - memory.time, 0.0))
        towards = self._shares * (memory.stress + stress) / 2
        return RelaxationState(kept * memory.faded + (1 - kept) * towards, stress, time)

    def _kept(self, elapsed: float) -> Array:
        return self._relaxation.kept(elapsed)[:, None, None, None]
