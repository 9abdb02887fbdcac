"""Closed-form solutions of membrane mechanics, for comparison with the simulator.

Pure functions, SI units.

Rectangle 2a x 2b under pressure p. T0 is the pre-tension per length, E h the membrane stiffness,
and nu the Poisson ratio:

    p = C1(b/a) T0 w0 / a^2 + C2(b/a, nu) E h w0^3 / a^4                (Eq. M1)

Each coefficient is exact where the other term vanishes. In between, the shapes differ, and the sum
is up to 4 % low. The table was recomputed by Ritz, series and finite elements. These methods agree
to 0.01 %; published fits are 1-1.6 % low.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.design import SensorDesign
from mjtactile.core.neo_hookean import Law, equibiaxial_stress
from mjtactile.core.types import Array

_NEWTON = 60  # maximum number of steps; six are sufficient
_ASPECT = (1.0, 1.25, 4 / 3, 1.5, 2.0, 3.0, 4.0)
_C1 = (3.3934493, 2.7929932, 2.6675326, 2.4808630, 2.1954508, 2.0377822, 2.0077390)
_POISSON = (0.3, 0.45, 0.49, 0.5)
_C2 = (
    (2.6565755, 3.2229637, 3.4290257, 3.4855694),
    (1.8907476, 2.2762197, 2.4170213, 2.4556830),
    (1.7765972, 2.1292712, 2.2584356, 2.2939176),
    (1.6387461, 1.9459958, 2.0592634, 2.0904129),
    (1.5087289, 1.7555740, 1.8486688, 1.8743754),
    (1.4764684, 1.6953797, 1.7807478, 1.8044870),
    (1.4694049, 1.6811347, 1.7650312, 1.7884530),
)


def _monotone_cubic(x: ArrayLike, y: ArrayLike, at: float) -> Array:
    """Interpolate with a monotone cubic along the first axis of `y` (Fritsch and Butland 1984).
    SciPy's `pchip` is the same, but its import takes 0.1 s."""
    x = np.asarray(x, dtype=float)
    y = np.asarray(y, dtype=float)
    h = np.diff(x).reshape(-1, *[1] * (y.ndim - 1))
    m = np.diff(y, axis=0) / h
    d = np.zeros_like(y)
    before = 2 * h[1:] + h[:-1]
    after = h[1:] + 2 * h[:-1]
    rises = m[1:] * m[:-1] > 0  # else it is level there
    compliance = before / np.where(rises, m[:-1], 1) + after / np.where(rises, m[1:], 1)
    d[1:-1][rises] = ((before + after) / compliance)[rises]
    for end, step in ((0, 1), (-1, -1)):
        h0 = h[end]
        h1 = h[end + step]
        m0 = m[end]
        m1 = m[end + step]
        slope = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
        overshoots = (m0 * m1 < 0) & (np.abs(slope) > 3 * np.abs(m0))
        slope = np.where(overshoots, 3 * m0, slope)
        d[end] = np.where(slope * m0 > 0, slope, 0.0)
    k = int(np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2))
    t = (at - x[k]) / h[k]
    return (
        (1 + 2 * t) * (1 - t) ** 2 * y[k]
        + t**2 * (3 - 2 * t) * y[k + 1]
        + h[k] * (t * (1 - t) ** 2 * d[k] - t**2 * (1 - t) * d[k + 1])
    )


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    """Find the root of a `function` that decreases from `low` to `high`, by bisection to the last
    bit.

    Importing scipy's solver takes a quarter of a second.
    """
    while low < (midpoint := (low + high) / 2) < high:
        if function(midpoint) > 0:
            low = midpoint
        else:
            high = midpoint
    return midpoint


@cache
def rectangle_coefficients(aspect: float, poisson: float) -> tuple[float, float]:
    """Return C1 and C2 of Eq. M1 for b/a = `aspect` (1 to 4) and nu (0.3 to 0.5); NaN outside the
    table."""
    if not (_ASPECT[0] <= aspect <= _ASPECT[-1] and _POISSON[0] <= poisson <= _POISSON[-1]):
        return np.nan, np.nan
    table = np.array(_C2)  # one row per aspect ratio
    if aspect in _ASPECT:
        c2 = np.interp(poisson, _POISSON, table[_ASPECT.index(aspect)])
    else:
        c2 = _monotone_cubic(_ASPECT, _monotone_cubic(_POISSON, table.T, poisson), aspect)
    return float(_monotone_cubic(_ASPECT, _C1, aspect)), float(c2)


def bulge_height(design: SensorDesign, gauge_pressure: float) -> float:
    """Return the center height w0, m, of the membrane inflated by a gauge pressure, Pa.

    The outline is a rectangle, a circle (C1 = 4, Hencky's C2) or an ellipse. The equation is Eq.
    M1, or Eq. M7 for neo-Hookean rubber. The result is NaN outside of the tables and for other
    outlines. It is also NaN if the rubber cannot hold the pressure.
    """
    membrane = design.membrane
    if membrane.law is Law.STVK:
        return _hookean_height(design, membrane.young, gauge_pressure)
    half_width = min(design.frame.length, design.frame.width) / 2

    def missing(height: float) -> float:
        stretch = membrane.pre_stretch * (1 + MEAN_STRETCH * (height / half_width) ** 2)
        rubber = equibiaxial_stress(stretch, membrane.young, membrane.poisson, Law.NEO_HOOKEAN)
        plain = equibiaxial_stress(stretch, membrane.young, membrane.poisson, Law.STVK)
        secant = membrane.young * rubber / plain
        return _hookean_height(design, secant, abs(gauge_pressure)) - height

    minimum = 1e-3 * half_width
    maximum = 1.5 * half_width
    if not np.isfinite(missing(minimum)) or missing(maximum) > 0:
        return np.nan
    height = (
        _root(missing, minimum, maximum) if missing(minimum) > 0 else minimum + missing(minimum)
    )
    return float(np.copysign(height, gauge_pressure))


def _hookean_height(design: SensorDesign, young: float, gauge_pressure: float) -> float:
    """Solve Eq. M1 for a modulus of `young` Pa.

    Relative to the mounted membrane, stretched by l, the stiffness is l^2 E h
    (docs/theory/membrane_inverse.md, Eq. F4).
    """
    short, long = sorted((design.frame.width, design.frame.length))
    a = short / 2
    membrane = design.membrane
    if design.frame.shape == "circle":
        c1 = 4.0
        c2 = hencky_factor(membrane.poisson) ** -3
    elif design.frame.shape == "ellipse":
        c1 = 2 * (1 + (short / long) ** 2)  # of a paraboloid, exactly
        c2 = _ellipse_cubic(long / short, membrane.poisson)
    elif design.frame.shape != "rectangle":
        return np.nan
    else:
        c1, c2 = rectangle_coefficients(long / short, membrane.poisson)
    stress = equibiaxial_stress(membrane.pre_stretch, young, membrane.poisson, Law.STVK)
    linear = c1 * membrane.thickness * stress / a**2
    cubic = c2 * young * membrane.thickness * membrane.pre_stretch**2 / a**4
    if not np.isfinite(linear + cubic) or linear < 0:
        return np.nan
    if gauge_pressure == 0:
        return 0.0
    height = (abs(gauge_pressure) / cubic) ** (1 / 3)  # upper bound: the height without pre-tension
    for _ in range(_NEWTON):  # from above, where the curve bends up: never past the root
        missing = abs(gauge_pressure) - linear * height - cubic * height**3
        lower = height + missing / (linear + 3 * cubic * height**2)
        if not lower < height:
            break
        height = lower
    return float(np.sign(gauge_pressure) * height)


# C2 of ellipses with aspect ratios 1 to 4 (rows), for Poisson's ratios (columns). Computed with a
# spline membrane without pre-tension on 20 x 14 intervals at p a / E h = 2e-4. Its circle deviates
# by 0.1 % from Hencky's solution.
_ELLIPSE_ASPECT = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0)
_ELLIPSE_POISSON = (0.3, 0.4, 0.45, 0.49)
_ELLIPSE_C2 = (
    (3.5807, 4.0681, 4.3772, 4.6674),
    (2.4871, 2.8154, 3.0240, 3.2200),
    (2.0558, 2.3116, 2.4749, 2.6286),
    (1.7358, 1.9292, 2.0544, 2.1729),
    (1.6214, 1.7888, 1.8986, 2.0031),
    (1.5673, 1.7210, 1.8229, 1.9204),
    (1.5189, 1.6589, 1.7531, 1.8440),
)


def _ellipse_cubic(aspect: float, poisson: float) -> float:
    """Return C2 of an ellipse with the axis ratio `aspect`, length over width; NaN outside the
    table."""
    inside = _ELLIPSE_POISSON[0] <= poisson <= _ELLIPSE_POISSON[-1]
    if not inside or aspect > _ELLIPSE_ASPECT[-1]:
        return np.nan
    by_poisson = _monotone_cubic(list(_ELLIPSE_POISSON), np.array(_ELLIPSE_C2).T, poisson)
    return float(_monotone_cubic(list(_ELLIPSE_ASPECT), by_poisson, aspect))


MEAN_STRETCH = 0.6
"""Stretch increment of a bulge relative to the mounted membrane, over (w0 / a)^2.

The secant modulus is evaluated at this stretch (Eq. M7). The value is fitted to the reference's
heights (tests/physics/test_rubber.py). It includes M1's own error.
"""


HENCKY = {
    0.0: 0.7183192,
    0.2: 0.6774353,
    0.3: 0.6534433,
    1 / 3: 0.6447764,
    0.4: 0.6262551,
    0.45: 0.6111706,
    0.49: 0.5982436,
    0.5: 0.5948790,
}
"""w0 / a (E h / p a)^(1/3) of a flat clamped circle without pre-tension, by Poisson ratio (Hencky's
series)."""


def hencky_factor(poisson: float) -> float:
    """Return w0 / a (E h / p a)^(1/3) of Eq. M2 for nu from 0 to 0.5."""
    return float(_monotone_cubic(list(HENCKY), list(HENCKY.values()), poisson))


def stvk_height_error(design: SensorDesign, gauge_pressure: float) -> float:
    """Return the relative height difference of a neo-Hookean and a St. Venant-Kirchhoff membrane
    under the same gauge pressure, Pa (Eq. M7). NaN if one of the heights is unknown."""
    rubber, plain = (
        bulge_height(
            replace(design, membrane=replace(design.membrane, law=law)), abs(gauge_pressure)
        )
        for law in (Law.NEO_HOOKEAN, Law.STVK)
    )
    return rubber / plain - 1 if plain else 0.0
