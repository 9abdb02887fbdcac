"""Closed forms of membrane mechanics that the simulator is compared with. Pure functions, SI units.

Rectangle 2a x 2b under pressure p, pre-tension T0 per length, membrane stiffness E h, Poisson ratio nu:

    p = C1(b/a) T0 w0 / a^2 + C2(b/a, nu) E h w0^3 / a^4                                       (Eq. M1)

Each coefficient is exact where the other term vanishes; between, the shapes differ and the sum is good to about 2 %.
The table was recomputed by Ritz, series and finite elements, which agree to 0.01 %; fits in print are 1-1.6 % low.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator
from scipy.optimize import brentq

from mjtactile.design import SensorDesign

_ASPECT = (1.0, 1.25, 4 / 3, 1.5, 2.0, 3.0, 4.0)
_C1 = (3.3934493, 2.7929932, 2.6675326, 2.4808630, 2.1954508, 2.0377822, 2.0077390)
_POISSON = (0.3, 0.45, 0.49, 0.5)
_C2 = ((2.6565755, 3.2229637, 3.4290257, 3.4855694), (1.8907476, 2.2762197, 2.4170213, 2.4556830),
       (1.7765972, 2.1292712, 2.2584356, 2.2939176), (1.6387461, 1.9459958, 2.0592634, 2.0904129),
       (1.5087289, 1.7555740, 1.8486688, 1.8743754), (1.4764684, 1.6953797, 1.7807478, 1.8044870),
       (1.4694049, 1.6811347, 1.7650312, 1.7884530))


def rectangle_coefficients(aspect: float, poisson: float) -> tuple[float, float]:
    """C1, C2 of Eq. M1 for b/a = `aspect` (1 to 4) and nu (0.3 to 0.5); NaN outside of the table."""
    if not (_ASPECT[0] <= aspect <= _ASPECT[-1] and _POISSON[0] <= poisson <= _POISSON[-1]):
        return np.nan, np.nan
    c1 = float(PchipInterpolator(_ASPECT, _C1)(aspect))
    c2 = float(RegularGridInterpolator((_ASPECT, _POISSON), _C2, method="pchip" if aspect not in _ASPECT else "linear")(
        (aspect, poisson)))
    return c1, c2


def bulge_height(design: SensorDesign, pressure_gauge: float) -> float:
    """Height w0, m, of the middle of the inflated rectangle at a gauge pressure, Pa (Eq. M1); NaN outside of the table.

    Seen from the mounted sheet, stretched by l, the stiffness is l^2 E h (docs/equations.md, Eq. F4).
    """
    short, long = sorted((design.frame.width, design.frame.length))
    a, sheet = short / 2, design.membrane
    c1, c2 = rectangle_coefficients(long / short, sheet.poisson)
    linear = c1 * sheet.pretension / a**2
    cubic = c2 * sheet.young * sheet.thickness * sheet.pre_stretch**2 / a**4
    if not np.isfinite(linear + cubic) or linear < 0:
        return np.nan
    height = abs(pressure_gauge) ** (1 / 3) / cubic ** (1 / 3)  # the membrane without pre-tension: an upper bound
    if height == 0:
        return 0.0
    return float(np.sign(pressure_gauge) * brentq(lambda w: linear * w + cubic * w**3 - abs(pressure_gauge), 0.0, height * 1.01))


HENCKY = {0.0: 0.7183192, 0.2: 0.6774353, 0.3: 0.6534433, 1 / 3: 0.6447764, 0.4: 0.6262551, 0.45: 0.6111706,
          0.49: 0.5982436, 0.5: 0.5948790}
"""w0 / a (E h / p a)^(1/3) of a flat clamped circle without pre-tension, by Poisson ratio (Hencky's series)."""


def hencky_height(radius: float, stiffness: float, poisson: float, pressure: float) -> float:
    """Height, m, of a clamped circular membrane of `radius` m and `stiffness` E h N/m under `pressure` Pa (Eq. M2)."""
    factor = float(PchipInterpolator(list(HENCKY), list(HENCKY.values()))(poisson))
    return radius * factor * (pressure * radius / stiffness) ** (1 / 3)
