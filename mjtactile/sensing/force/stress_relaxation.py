"""Stress relaxation of the rubber in sensing.

It uses the model of `mjtactile.core.relaxation` at the Gauss points of the membrane model. For
sensing only; the simulator has separate code.

The estimated shape gives the stress S at every point. From one image to the next, each term relaxes
as this stress determines (Eq. F23). The relaxed stress is a load on the membrane like any other.
Without it, it would be estimated as contact force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.relaxation import Relaxation
from mjtactile.core.types import Array
from mjtactile.sensing.force.spline_fem import SplineMembrane


@dataclass(frozen=True, eq=False)
class RelaxationState:
    """Relaxed stress of each term, `faded` (terms, 3, qx, qy), N/m. `stress` (3, qx, qy), N/m, is
    the long-term stress. Both hold at `time`, s."""

    faded: Array
    stress: Array
    time: float

    @property
    def total(self) -> Array:
        """Total relaxed stress of all terms (3, qx, qy), N/m."""
        return self.faded.sum(axis=0)


class RelaxingMembrane:
    """Stress relaxation of one sensor's membrane. `scale` is the factor on its long-term modulus,
    as in `InverseRest`."""

    def __init__(self, membrane: SplineMembrane, relaxation: Relaxation):
        self._membrane = membrane
        self._relaxation = relaxation
        self._fractions = relaxation.fractions[:, None, None, None]

    def start(self, c: Array, scale: float, inflated_s: float, time: float) -> RelaxationState:
        """Return the state at `time`, s, of a membrane after inflation. The membrane was always
        flat, then at `c` (3, n), m, for `inflated_s` s."""
        flat = scale * self._membrane.stress(np.zeros_like(c))
        stress = scale * self._membrane.stress(c)
        kept = self._kept_fraction(inflated_s)
        return RelaxationState(self._fractions * (kept * flat + (1 - kept) * stress), stress, time)

    def after(
        self, memory: RelaxationState, c: Array, scale: float, time: float
    ) -> RelaxationState:
        """Return the relaxation state at `time` s, with the membrane at `c` (3, n), m."""
        stress = scale * self._membrane.stress(c)
        kept = self._kept_fraction(max(time - memory.time, 0.0))
        towards = self._fractions * (memory.stress + stress) / 2
        return RelaxationState(kept * memory.faded + (1 - kept) * towards, stress, time)

    def _kept_fraction(self, elapsed: float) -> Array:
        return self._relaxation.kept(elapsed)[:, None, None, None]
