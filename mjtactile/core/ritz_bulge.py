"""Inflated membrane by Ritz's method, accurate to four digits.

It is the reference for the height of a simulated membrane. Pure functions, SI units. The method
uses neither the simulator's triangles nor sensing's splines.

The displacement of the mounted membrane is a polynomial multiplied by a bubble function. The
polynomial's coordinates are those of a disc (of a square, for rectangles). The bubble, 1 - r^2 or
(1 - x^2)(1 - y^2), vanishes on the frame. The outline's map (`mjtactile.core.outline`) maps the
disc to the opening. The coefficients satisfy the principle of virtual work for stress, gas and
weight (docs/theory/closed_forms.md, Eq. M8):

    int P : grad v dA = p int (x_1 x x_2) . v dA - g rho h / l^2 int v_z dA,    P = h F S(l^2 F^T F)

The solution is smooth if the outline is smooth. The error decreases by a factor with every
degree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebvander
from numpy.polynomial.legendre import leggauss

from mjtactile.core import analytical_solutions
from mjtactile.core.design import SensorDesign
from mjtactile.core.neo_hookean import Law, shear_modulus
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array

_DEGREE = 5  # degree of the polynomials in x^2 and y^2
_DEGREE_POLYGON = 3  # degree without the symmetry, with four times as many terms
GRAVITY = 9.81
_SCALE = 1e-3  # length scale, m: the unknowns are of order 1
_NEWTON = 30
_THICKNESS_STEPS = 12  # quadratic: enough for the last digit
_STEPS = (0.3, 1.0)  # load steps, as fractions of the pressure
_CONVERGED = 1e-8
_SMALL = 1e-6  # step of finite differences


def inflated_height(
    design: SensorDesign, gauge_pressure: float, *, gravity: float = 0.0, degree: int | None = None
) -> float:
    """Compute the center's height above the frame, m, of a membrane with any outline and law.

    The gauge pressure is in Pa, gravity, m/s^2, into the chamber. `degree` is that of the
    polynomials in x^2 and y^2; default 5, for polygons 3. NaN if the rubber cannot hold the
    pressure, or if the frame is more than four times as long as wide.
    """
    # start: the bulge of a membrane of equal length and width
    frame = replace(design.frame, shape="ellipse")
    first = analytical_solutions.bulge_height(replace(design, frame=frame), gauge_pressure)
    if not np.isfinite(first):
        return np.nan
    weight = gravity * design.membrane.density * design.membrane.thickness
    weight /= design.membrane.pre_stretch**2
    if degree is None:
        degree = _DEGREE_POLYGON if design.frame.shape == "polygon" else _DEGREE
    membrane = _RitzMembrane.of(design, degree)
    unknown = np.zeros(3 * membrane.count)
    unknown[2 * membrane.count] = _STEPS[0] ** 0.5 * first / _SCALE
    for fraction in _STEPS:
        found = _root(membrane, unknown, fraction * gauge_pressure, fraction * weight)
        if found is None:
            return np.nan
        unknown = found
    return float(_SCALE * unknown[2 * membrane.count :] @ membrane.middle)


def _root(membrane: _RitzMembrane, unknown: Array, pressure: float, weight: float) -> Array | None:
    """Compute the equilibrium coefficients (3 k,), _SCALE m; None if no equilibrium is found.

    Newton's method uses finite differences.
    """
    for _ in range(_NEWTON):
        missing = membrane.residual(unknown, pressure, weight)
        if not np.isfinite(missing).all():
            return None
        moved = unknown + _SMALL * np.eye(len(unknown))
        slope = np.array([membrane.residual(item, pressure, weight) - missing for item in moved])
        step = np.linalg.solve(slope.T / _SMALL, -missing)
        maximum = float(np.abs(step).max())
        unknown = unknown + step * min(1.0, 1.0 / maximum)  # limit the step to 1 mm
        if maximum < _CONVERGED:
            return unknown
    return None


@dataclass(frozen=True, eq=False)
class _RitzMembrane:
    """Values of the trial functions at the integration points.

    Attributes:
        membrane: The rubber.
        weights: Area weights of the mounted membrane (q,), m^2.
        values: Values of the functions of u_x, u_y, u_z (3, k, q).
        slopes: Derivatives by x and y (3, 2, k, q), 1/m.
        middle: Values (k,) of the functions of u_z at the center of the frame.
    """

    membrane: Membrane
    weights: Array
    values: Array
    slopes: Array
    middle: Array

    @classmethod
    def of(cls, design: SensorDesign, degree: int) -> _RitzMembrane:
        frame = design.frame
        symmetric = frame.shape != "polygon"
        disc = frame.outline is not None
        positions, areas = _quarter(2 * degree + 4, disc)
        if not symmetric:
            signs = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)])
            positions = np.concatenate([positions * sign for sign in signs])
            areas = np.tile(areas / 4, 4)
        if frame.outline is None:
            jacobian = np.tile(np.diag([frame.length / 2, frame.width / 2]), (len(positions), 1, 1))
        else:
            jacobian = frame.outline.disc_jacobian(positions)
        bubble, by_position = _bubble(positions, disc)
        values = []
        slopes = []
        orders = []
        for odd in ((1, 0), (0, 1), (0, 0)):
            orders = _orders(degree, odd, symmetric)
            f, df = _products(positions, orders)
            values.append(bubble * f)
            by_own = bubble * df + by_position[:, None] * f  # (2, k, q)
            slopes.append(np.einsum("ikq,qij->jkq", by_own, np.linalg.inv(jacobian)))
        weights = areas * np.linalg.det(jacobian)
        at = np.zeros((1, 2))
        if frame.outline is not None:
            at = frame.outline.disc(at)
        at_center = (_bubble(at, disc)[0] * _products(at, orders)[0])[:, 0]
        return cls(design.membrane, weights, np.array(values), np.array(slopes), at_center)

    @property
    def count(self) -> int:
        """Functions of each component."""
        return self.values.shape[1]

    def residual(self, unknown: Array, pressure: float, weight: float) -> Array:
        """Return the residual forces (3 k,), N, under `pressure` Pa and `weight` N/m^2; zero in
        equilibrium."""
        c = _SCALE * unknown.reshape(3, -1)
        F = np.einsum("dk,dekq->deq", c, self.slopes)
        F[0, 0] += 1
        F[1, 1] += 1
        stress = _stress(F, self.membrane)
        P = self.membrane.thickness * np.einsum("dfq,feq->deq", F, stress)
        load = pressure * np.cross(F[:, 0], F[:, 1], axis=0)
        load[2] -= weight
        inner = np.einsum("deq,dekq->dk", self.weights * P, self.slopes)
        return (inner - np.einsum("dq,dkq->dk", self.weights * load, self.values)).ravel()


def _stress(F: Array, membrane: Membrane) -> Array:
    """Compute the second Piola-Kirchhoff stress (2, 2, q), Pa.

    F (3, 2, q) are the gradients relative to the mounted membrane.
    """
    C = membrane.pre_stretch**2 * np.einsum("dep,dfp->efp", F, F)
    trace = C[0, 0] + C[1, 1]
    unit = np.eye(2)[:, :, None]
    if membrane.law is Law.STVK:
        nu = membrane.poisson
        strain = (C - unit) / 2
        return membrane.young / (1 - nu**2) * ((1 - nu) * strain + nu * (trace - 2) / 2 * unit)
    det = C[0, 0] * C[1, 1] - C[0, 1] ** 2
    half = membrane.poisson / (1 - 2 * membrane.poisson)  # lambda / 2 mu
    log_c = np.zeros_like(det)
    for _ in range(_THICKNESS_STEPS):
        c = np.exp(log_c)
        log_c = log_c - (c - 1 + half * (log_c + np.log(det))) / (c + half)
    mu = shear_modulus(membrane.young, membrane.poisson)
    return mu * (unit - np.exp(log_c) / det * (trace * unit - C))


def _quarter(count: int, disc: bool) -> tuple[Array, Array]:
    """Return Gauss points (q, 2) of a quarter of the unit disc or square, and four times their
    areas (q,)."""
    t, w = leggauss(count)
    t = (t + 1) / 2
    w = w / 2
    first, second = (axis.ravel() for axis in np.meshgrid(t, t, indexing="ij"))
    areas = 4 * np.outer(w, w).ravel()
    if not disc:
        return np.column_stack([first, second]), areas
    angle = np.pi / 2 * second
    positions = np.column_stack([first * np.cos(angle), first * np.sin(angle)])
    return positions, np.pi / 2 * first * areas


def _bubble(positions: Array, disc: bool) -> tuple[Array, Array]:
    """Return the bubble function (q,), 1 at the center and 0 on the frame, and its derivatives (2,
    q)."""
    x, y = positions.T
    if disc:
        return 1 - x**2 - y**2, np.array([-2 * x, -2 * y])
    return (1 - x**2) * (1 - y**2), np.array([-2 * x * (1 - y**2), -2 * y * (1 - x**2)])


def _orders(degree: int, odd: tuple[int, int], symmetric: bool) -> list[tuple[int, int]]:
    """Return the orders of the polynomials in x and y.

    If `symmetric`, they are even, or odd along the axes in `odd`. Otherwise all orders are
    returned.
    """
    if not symmetric:
        return [(i, total - i) for total in range(2 * degree + 1) for i in range(total + 1)]
    return [
        (2 * i + odd[0], 2 * (total - i) + odd[1])
        for total in range(degree + 1)
        for i in range(total + 1)
    ]


def _products(positions: Array, orders: list[tuple[int, int]]) -> tuple[Array, Array]:
    """Return the Chebyshev products T_i(x) T_j(y) (k, q) and their derivatives (2, k, q)."""
    i, j = np.array(orders).T
    maximum = int(max(i.max(), j.max()))
    (x, by_x), (y, by_y) = (_chebyshev(coordinate, maximum) for coordinate in positions.T)
    return x[i] * y[j], np.array([by_x[i] * y[j], x[i] * by_y[j]])


def _chebyshev(at: Array, maximum: int) -> tuple[Array, Array]:
    """Return T_0 to T_maximum at positions (q,), and their derivatives, both (maximum + 1, q)."""
    values = chebvander(at, maximum)
    slopes = values[:, : max(maximum, 1)] @ chebder(np.eye(maximum + 1), axis=0)
    return values.T, slopes.T
