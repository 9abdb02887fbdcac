"""The paper's calibration of force by area, dF = c dA (its Eq. 11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError


@dataclass(frozen=True)
class AreaCalibration:
    """The paper's calibration: `constant` c, N/m^2, of dF = c dA, and the rms `residual`, N, that
    it left."""

    constant: float
    residual: float

    @classmethod
    def fit(cls, area_change: ArrayLike, force: ArrayLike) -> AreaCalibration:
        """Fit a line through the origin to area changes, m^2, at known normal forces, N.

        The forces come from a load cell or weights. Raises InputError if the area did not change,
        or shrank under load: then no such constant exists.
        """
        dA = np.asarray(area_change, dtype=float)
        F = np.asarray(force, dtype=float)
        if not np.isfinite(dA).all() or float(dA @ F) <= 0:
            raise InputError(
                "the membrane area does not grow with the force",
                source="calibration",
                field="area_change",
            )
        constant = float(dA @ F / (dA @ dA))
        return cls(constant, float(np.sqrt(np.mean((F - constant * dA) ** 2))))

    def force(self, area_change: float) -> float:
        """Normal force, N, from the change of membrane area, m^2 (paper Eq. 11)."""
        return self.constant * area_change
