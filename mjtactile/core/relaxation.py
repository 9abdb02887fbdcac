"""Viscoelastic membrane: stress relaxation, and softening in the first cycles.

The parameters are a sensor file's `[relaxation]`. Pure functions, SI units.

The file's Young's modulus is the long-term one. Maxwell elements act in parallel. Each has a
fraction a_i of the long-term stress S(C) and a time constant tau_i. This is a Prony series
(docs/theory/membrane_inverse.md, F23):

    S_total(t) = S + sum q_i,    dq_i/dt = a_i dS/dt - q_i / tau_i

The stiffness for a fast deformation is 1 + sum a_i times the long-term one. The long-term stiffness
applies after a long hold. With the relaxed stress of each element, r_i = a_i S - q_i,

    S_total = (1 + sum a_i) S - sum r_i,    dr_i/dt = (a_i S - r_i) / tau_i

without a derivative of the strain. Softening (Mullins) reduces S by a fraction. It depends on
W_max, the maximum energy ever stored at a position (Ogden and Roxburgh 1999, with their r = 1 /
share and m = energy, beta = 0):

    S(C) -> (1 - share erf((W_max - W) / energy)) S(C)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.config_fields import KPA, entry, number
from mjtactile.core.field_types import Pairs
from mjtactile.core.toml import Section
from mjtactile.core.types import Array

MAX_TERMS = 8


@dataclass(frozen=True)
class Relaxation:
    """Stress relaxation of a membrane, and its softening after the first cycles; see the module.

    Attributes:
        terms: Fraction a_i of the long-term stress and time constant tau_i, s, of each Maxwell
            element.
        softening: Maximum fraction of the stress lost in the first cycles.
        softening_energy: Energy below the maximum at which 84 % of this loss occurs, J/m^3.
    """

    terms: tuple[tuple[float, float], ...] = entry(
        Pairs(
            key="terms_s",
            units=(1.0, 1.0),
            about=(
                "[fraction, s] of each term: stress in addition to the long-term stress, and time "
                "constant of its decay"
            ),
        )
    )
    softening: float = number(
        "mullins_fraction", 0, 0.9, default=0.0, about="fraction lost in the first cycles (Mullins)"
    )
    softening_energy: float = number(
        "mullins_energy_kJ_m3",
        1e-3,
        1e4,
        KPA,
        default=5e3,
        about="energy below the maximum at which 84 % of this loss occurs",
    )

    @property
    def fractions(self) -> Array:
        """a_i, (terms,)."""
        return np.array([fraction for fraction, _ in self.terms])

    @property
    def times(self) -> Array:
        """tau_i, (terms,) s."""
        return np.array([seconds for _, seconds in self.terms])

    @property
    def quick(self) -> float:
        """Ratio of the stiffness for a fast deformation to the long-term stiffness."""
        return 1.0 + float(self.fractions.sum())

    def kept(self, elapsed: float) -> Array:
        """Return the fraction (terms,) of each element's stress that remains after `elapsed` s."""
        return np.exp(-elapsed / self.times)

    def check(self, section: Section) -> None:
        """Raise InputError unless terms are positive and not too many."""
        if len(self.terms) > MAX_TERMS:
            message = f"has {len(self.terms)} terms; at most {MAX_TERMS} are allowed"
            raise section.fail("relaxation.terms_s", message)
        for fraction, seconds in self.terms:
            if not (0 < fraction <= 2 and 1e-3 <= seconds <= 1e7):
                message = (
                    f"[{fraction:g}, {seconds:g}] is outside the range: a fraction above 0, up "
                    "to 2, and 0.001 to 1e7 seconds"
                )
                raise section.fail("relaxation.terms_s", message)
        if not self.terms and not self.softening:
            message = "terms_s is empty and mullins_fraction is 0; set one or remove the section"
            raise section.fail("relaxation.terms_s", message)


def decades(rate: float, first: float = 1.0, last: float = 1e4) -> tuple[tuple[float, float], ...]:
    """Return terms of a rubber that loses the same fraction of its stress in every decade of time.

    `rate` is that fraction: 0.02 for unfilled natural rubber. There is one term per decade, from
    the `first` to the `last` time constant, s. In between, the sum of exponentials deviates by at
    most 0.1 of the rate from a straight line over the logarithm of time.
    """
    count = round(float(np.log10(last / first))) + 1
    return tuple((rate, float(first * 10**k)) for k in range(count))
