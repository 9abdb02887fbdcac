"""Constitutive law of a membrane in the form that the kernel uses. SI units.

See docs/theory/membrane_inverse.md, Eq. F4 and X2. The stress of a neo-Hookean membrane is mu h (I
- q A) with A = tr(C) I - C. Here q is a function of det C alone. Over the stretch range of a
  membrane, a polynomial of 1 / sqrt(det C) represents q accurately. The inner loop therefore needs
  no logarithm.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mjtactile.core.neo_hookean import Law, equibiaxial_stress, shear_modulus
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array
from mjtactile.core.types.arrays import fixed

DEGREE = 10
# range relative to the mounted membrane; mean of both directions
_MIN_STRETCH, _MAX_STRETCH = 0.75, 1.9
_MIN_POISSON = 0.005  # below, the thickness hardly changes, and the equation for it is stiff
_NEWTON = 60


def law_numbers(membrane: Membrane) -> tuple[tuple[float, ...], Array]:
    """Return the parameters and the polynomial (DEGREE + 1,) of a membrane's constitutive law.

    The parameters are 1.0 if it is neo-Hookean (else 0.0), modulus times thickness, N/m (mu h, or E
    h / (1 - nu^2)), Poisson's ratio, and center and scale of the polynomial's argument.
    """
    center, per_unit, powers = _polynomial(membrane)
    neo_hookean = membrane.law is not Law.STVK
    if neo_hookean:
        modulus = shear_modulus(membrane.young, membrane.poisson)
    else:
        modulus = membrane.young / (1 - membrane.poisson**2)
    return (
        float(neo_hookean),
        modulus * membrane.thickness,
        membrane.poisson,
        center,
        per_unit,
    ), powers


def tension(membrane: Membrane, area_ratio: float) -> float:
    """Return the tension, N/m, of the membrane stretched uniformly to an `area_ratio`.

    The force per mounted length is h S l with l = sqrt(J). Over the deformed length it is h S.
    """
    stretch = membrane.pre_stretch * np.sqrt(area_ratio)
    return membrane.thickness * equibiaxial_stress(
        float(stretch), membrane.young, membrane.poisson, membrane.law
    )


def tension_slope(membrane: Membrane, area_ratio: float) -> float:
    """Return dT/dJ, N/m, of `tension` at `area_ratio`."""
    step = 1e-4
    return (tension(membrane, area_ratio + step) - tension(membrane, area_ratio - step)) / (
        2 * step
    )


@lru_cache(maxsize=64)
def _polynomial(membrane: Membrane) -> tuple[float, float, Array]:
    """Return center, scale and coefficients of q in 1 / sqrt(det C), within 1e-6 of q."""
    nu = max(membrane.poisson, _MIN_POISSON)
    half = nu / (1 - 2 * nu)  # lambda / 2 mu
    ends = membrane.pre_stretch**-2 * np.array([_MAX_STRETCH**-2, _MIN_STRETCH**-2])
    center, half_range = float(ends.mean()), float(np.diff(ends)[0] / 2)
    t = np.cos(np.linspace(0, np.pi, 400))
    log_det = -2 * np.log(center + half_range * t)
    x = -nu / (1 - nu) * log_det  # ln c, first order; c is the square of the thickness's stretch
    for _ in range(_NEWTON):
        c = np.exp(x)
        x = x - (c - 1 + half * (x + log_det)) / (c + half)
    q = np.exp(x - log_det)
    chebyshev = np.polynomial.chebyshev.Chebyshev.fit(t, q, DEGREE, w=q**-0.5)
    powers = chebyshev.convert(kind=np.polynomial.Polynomial).coef
    return center, 1 / half_range, fixed(powers)
