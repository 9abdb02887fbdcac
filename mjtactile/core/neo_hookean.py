"""Neo-Hookean material law of the membrane in plane stress.

Pure functions, SI units (docs/theory/membrane_inverse.md, Eq. F4).

    W = mu/2 (I1 - 3 - 2 ln J) + lambda/2 (ln J)^2,    S = mu (I - c C^-1)

C is the in-plane right Cauchy-Green tensor relative to the unstretched membrane. c is the square of
the thickness stretch. Zero stress through the thickness determines it: mu (c - 1) + lambda/2 ln(c
det C) = 0. In two dimensions det(C) C^-1 = tr(C) I - C. S is therefore linear in I and C. The
coefficients depend on tr C and det C.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from mjtactile.core.types import Array


class Law(StrEnum):
    """Stress-strain law of the membrane. All laws have Young's modulus and Poisson's ratio at small
    strain."""

    NEO_HOOKEAN = "neo-Hookean"
    STVK = "St. Venant-Kirchhoff"


def shear_modulus(young: float, poisson: float) -> float:
    """Return the shear modulus mu, Pa."""
    return young / (2 * (1 + poisson))


def thickness_over_area(log_det: Array, poisson: float) -> Array:
    """Return c / det C for ln det C = `log_det` (any shape).

    Two Newton steps leave an error of 1e-6 up to stretches of 1.4.
    """
    half = poisson / (1 - 2 * poisson)  # lambda / 2 mu
    x = log_det * (-poisson / (1 - poisson))  # ln c, first order
    for _ in range(2):
        c = np.exp(x)
        x = x - (c - 1 + half * (x + log_det)) / (c + half)
    return np.exp(x - log_det)


def principal_stresses(stretches: Array, young: float, poisson: float, law: Law) -> Array:
    """Return the second Piola-Kirchhoff stresses S (m, 2), Pa, along the principal axes, for
    principal stretches (m, 2)."""
    squares = stretches**2
    if law is Law.STVK:
        strains = (squares - 1) / 2
        return young / (1 - poisson**2) * (strains + poisson * strains[:, ::-1])
    ratio = thickness_over_area(np.log(squares[:, 0] * squares[:, 1]), poisson)
    return shear_modulus(young, poisson) * (1 - ratio[:, None] * squares[:, ::-1])


def equibiaxial_stress(stretch: float, young: float, poisson: float, law: Law) -> float:
    """Compute the second Piola-Kirchhoff stress S, Pa, of a membrane with equibiaxial `stretch`."""
    if law is Law.STVK:
        return young / (1 - poisson) * (stretch**2 - 1) / 2
    ratio = float(thickness_over_area(np.asarray(4 * np.log(stretch)), poisson))
    return shear_modulus(young, poisson) * (1 - ratio * stretch**2)
