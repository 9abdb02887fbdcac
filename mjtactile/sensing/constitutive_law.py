"""Membrane stress and its derivative by the constitutive law of the sensor file.

See docs/theory/membrane_inverse.md, Eq. F4. For sensing only; the simulator has separate code.

Both are functions of the right Cauchy-Green tensor C of the membrane, relative to its free state.
For a neo-Hookean membrane S = mu (I - q A). Here A = tr(C) I - C and q = c / det C. A is the
derivative of det C, so dq/dC = q' A.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.neo_hookean import Law
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array

# stretches of 0.47 to 2.7; linear between: q is good to 1e-6
_LOG_DET = np.linspace(-3.0, 4.0, 7001)
_NEWTON_STEPS = 10  # 8 take every Poisson's ratio to rounding
_MIN_POISSON = 0.005  # minimum: below it exp(1 / nu) overflows, and the thickness hardly changes


class ConstitutiveLaw:
    """Stress and moduli of one sensor's membrane, integrated over its thickness, N/m."""

    def __init__(self, membrane: Membrane):
        self._law = membrane.law
        self._nu = membrane.poisson
        self._plane = membrane.young * membrane.thickness / (1 - membrane.poisson**2)
        self._mu = membrane.young * membrane.thickness / (2 * (1 + membrane.poisson))
        nu = max(membrane.poisson, _MIN_POISSON)
        half = nu / (1 - 2 * nu)  # lambda / 2 mu
        c = _thickness(half)
        self._q = c * np.exp(-_LOG_DET)
        self._slope = -self._q * np.exp(-_LOG_DET) * (1 + half / (c + half))  # q'

    @property
    def parameters(self) -> tuple[float, ...]:
        """Parameters as kernels/spline_fem.h expects them. 1 if neo-Hookean, the modulus, Poisson's
        ratio, and the first abscissa and samples per unit of `table`."""
        neo_hookean = self._law is not Law.STVK
        per_unit = (len(_LOG_DET) - 1) / (_LOG_DET[-1] - _LOG_DET[0])
        return (
            float(neo_hookean),
            self._mu if neo_hookean else self._plane,
            self._nu,
            _LOG_DET[0],
            per_unit,
        )

    @property
    def table(self) -> Array:
        """q and q' (2, count) over the logarithm of det C."""
        return np.stack([self._q, self._slope])

    def stress(self, C11: Array, C22: Array, C12: Array) -> Array:
        """Return the second Piola-Kirchhoff stress (3, ...): S11, S22, S12."""
        if self._law is Law.STVK:
            E11 = (C11 - 1) / 2
            E22 = (C22 - 1) / 2
            nu = self._nu
            return self._plane * np.stack([E11 + nu * E22, E22 + nu * E11, (1 - nu) * C12 / 2])
        q = np.interp(self._log_det(C11, C22, C12), _LOG_DET, self._q)
        return self._mu * np.stack([1 - q * C22, 1 - q * C11, q * C12])

    def moduli(self, C11: Array, C22: Array, C12: Array) -> Array:
        """Return the tangent moduli dS/dE (6, ...): 1111, 2222, 1122, 1112, 2212, 1212; symmetric
        otherwise."""
        if self._law is Law.STVK:
            ones = np.ones_like(C11)
            none = np.zeros_like(C11)
            nu = self._nu
            return self._plane * np.stack([ones, ones, nu * ones, none, none, (1 - nu) / 2 * ones])
        log_det = self._log_det(C11, C22, C12)
        q, slope = (
            2 * self._mu * np.interp(log_det, _LOG_DET, table) for table in (self._q, self._slope)
        )
        A11 = C22
        A22 = C11
        A12 = -C12
        return np.stack(
            [
                -slope * A11 * A11,
                -slope * A22 * A22,
                -slope * A11 * A22 - q,
                -slope * A11 * A12,
                -slope * A22 * A12,
                q / 2 - slope * A12 * A12,
            ]
        )

    @staticmethod
    def _log_det(C11: Array, C22: Array, C12: Array) -> Array:
        return np.log(np.maximum(C11 * C22 - C12 * C12, 1e-3))


def _thickness(half: float) -> Array:
    """Compute the squared thickness stretch c over `_LOG_DET`. It solves c - 1 + half ln(c det C) =
    0 by Newton's method for ln c. The left side is increasing and convex. So iterations from above
    decrease to the root. The equation is Lambert's, but the import of scipy takes a sixth of a
    second."""
    log_c = np.maximum(0.0, -_LOG_DET)
    for _ in range(_NEWTON_STEPS):
        c = np.exp(log_c)
        log_c = log_c - (c - 1 + half * (log_c + _LOG_DET)) / (c + half)
    return np.exp(log_c)
