"""Rubber that remembers: what a sensor file's `[relaxation]` says of stress that fades and of the
first cycles. Pure functions, SI units.

The file's Young's modulus is the lasting one. Beside it act Maxwell elements, each with a share
a_i of the lasting stress S(C) and a time constant tau_i (a Prony series;
docs/theory/membrane_inverse.md, F23):

    S_total(t) = S + sum q_i,    dq_i/dt = a_i dS/dt - q_i / tau_i

so that a quick deformation meets a sheet that is 1 + sum a_i times as stiff, and one that is held
long enough the file's. Written with r_i = a_i S - q_i, what each element has given up,

    S_total = (1 + sum a_i) S - sum r_i,    dr_i/dt = (a_i S - r_i) / tau_i

which has no derivative of the strain. Softening (Mullins) takes a share of S that depends on the
most that was ever stored at a place, W_most (Ogden and Roxburgh 1999, with their r = 1 / share and
m = energy, beta = 0):

    S(C) -> (1 - share erf((W_most - W) / energy)) S(C)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.config_fields import KPA, entry, number
from mjtactile.core.field_types import Pairs
from mjtactile.core.toml import Section
from mjtactile.core.types import Array

MAX_TERMS = 8


@dataclass(frozen=True)
class Relaxation:
    """How a sheet's stress fades, and how much softer it is after its first cycles; see the module.

    Attributes:
        terms: Share a_i of the lasting stress and time constant tau_i, s, of each Maxwell element.
        softening: Largest share of the stress that the first cycles take.
        softening_energy: Energy, J/m^3, by which a place must be below its most for 84 % of that.
    """

    terms: tuple[tuple[float, float], ...] = entry(
        Pairs(
            key="terms_s",
            units=(1.0, 1.0),
            about="[share, seconds] of each: stress beyond the lasting one that a quick stretch "
            "meets, and the time in which it fades to 37 %",
        )
    )
    softening: float = number(
        "mullins_fraction",
        0,
        0.9,
        default=0.0,
        about="of the stress, that the first cycles take (Mullins)",
    )
    softening_energy: float = number(
        "mullins_energy_kJ_m3",
        1e-3,
        1e4,
        KPA,
        default=5e3,
        about="energy below the most that was ever stored, at which 84 % of it is taken",
    )

    @property
    def shares(self) -> Array:
        """a_i, (terms,)."""
        return np.array([share for share, _ in self.terms])

    @property
    def times(self) -> Array:
        """tau_i, (terms,) s."""
        return np.array([seconds for _, seconds in self.terms])

    @property
    def quick(self) -> float:
        """How many times as stiff as the lasting one a quick deformation finds the sheet."""
        return 1.0 + float(self.shares.sum())

    def kept(self, elapsed: float) -> Array:
        """Share (terms,) of each element's stress that is left after `elapsed` s."""
        return np.exp(-elapsed / self.times)

    def check(self, section: Section) -> None:
        """See that terms are positive and not too many.

        Args:
            section: The file's table, for the message.

        Raises:
            InputError: Names the field and what is wrong with it.
        """
        if len(self.terms) > MAX_TERMS:
            raise section.fail(
                "relaxation.terms_s", f"{len(self.terms)} terms are more than {MAX_TERMS}"
            )
        for share, seconds in self.terms:
            if not (0 < share <= 2 and 1e-3 <= seconds <= 1e7):
                message = (
                    f"[{share:g}, {seconds:g}]: a share above 0, up to 2, "
                    "and 0.001 to 1e7 seconds are wanted"
                )
                raise section.fail("relaxation.terms_s", message)
        if not self.terms and not self.softening:
            raise section.fail(
                "relaxation.terms_s", "neither terms_s nor mullins_fraction says anything"
            )


def decades(rate: float, first: float = 1.0, last: float = 1e4) -> tuple[tuple[float, float], ...]:
    """Terms of rubber that gives up the same share of its stress in every decade of time.

    Args:
        rate: Share of the lasting stress in a decade: 0.02 for unfilled natural rubber.
        first: Shortest time constant, s.
        last: Longest, s.

    Returns:
        A term a decade: the sum of exponentials is within 0.1 of the rate of a straight line over
        the logarithm of time between them.
    """
    count = round(float(np.log10(last / first))) + 1
    return tuple((rate, float(first * 10**k)) for k in range(count))


def relaxed_modulus(relaxation: Relaxation, time: Any) -> Array:
    """Stress over the lasting one at `time` s after a step of strain, any shape: 1 + sum a_i
    exp(-t / tau_i)."""
    times = np.asarray(time, float)[..., None]
    return 1.0 + (relaxation.shares * np.exp(-times / relaxation.times)).sum(axis=-1)
