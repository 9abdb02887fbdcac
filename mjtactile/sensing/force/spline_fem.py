"""Spline finite element model of the membrane: forces, tangent stiffness and equilibrium.

It uses the rubber and gas of the sensor file. The displacement u(X) of the mounted flat membrane is
a tensor-product cubic B-spline, zero on the frame. Its generalized forces are those of membrane
stress, gas at gauge pressure p, and surface loads. See docs/theory/membrane_inverse.md, Eq. F3-F5,
F9. Coefficients are stored as (3, n): component by component, n = kx * ky splines with y fastest.
Splines overlap only their neighbors. So the stiffness is banded, except for the rank-one term of
the gas. The Sherman-Morrison formula handles that term separately. The arithmetic is in
mjtactile/kernels/spline_fem.c.

The splines are functions of the membrane's parametric coordinates, which fill a rectangle. For a
rectangular frame they are the positions X. Another outline is the image of the rectangle under the
smooth map of `mjtactile.core.outline`. The equations then stay the same. Derivatives by X follow
from the chain rule, areas from the determinant of the map. This is isogeometric analysis (Hughes,
Cottrell & Bazilevs, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.bspline import Cubic
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, MjtactileError
from mjtactile.core.types import Array
from mjtactile.kernels import band_stride, kernel
from mjtactile.sensing.constitutive_law import ConstitutiveLaw

# Gauss points per spline interval: the integrands vary over the marker spacing, several intervals
# wide
_GAUSS = 2
FEWEST_SPANS = 3  # four splines do not vanish in an interval
_NEWTON_STEPS = 80
_STEP_MAX = 1e-3  # maximum change of a coefficient per Newton step, m
_CONVERGED = 1e-9  # convergence tolerance of a step, m


@dataclass(frozen=True, eq=False)
class Gas:
    """Gas in the chamber. It is a sealed amount, p V^gamma = `constant`. If `constant` is None, a
    valve keeps `gauge_pressure` Pa."""

    gauge_pressure: float
    constant: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.gauge_pressure, int | float | np.number) or not np.isfinite(
            self.gauge_pressure
        ):
            raise InputError(
                f"{self.gauge_pressure!r} is not a pressure in Pa",
                source="chamber",
                field="gauge_pressure",
            )

    def pressure_at(self, volume: float, ambient: float, gamma: float) -> float:
        """Return the gauge pressure, Pa, at a gas volume, m^3 (Eq. G1)."""
        if self.constant is None:
            return self.gauge_pressure
        return self.constant / volume**gamma - ambient

    def stiffness(self, volume: float, gamma: float) -> float:
        """Return -dp/dV, Pa/m^3 (Eq. G3)."""
        if self.constant is None:
            return 0.0
        return gamma * self.constant / volume ** (gamma + 1)


@dataclass(frozen=True, eq=False)
class State:
    """Deformation state: coefficients `c` (3, n), m, and the factor `scale` on Young's modulus.
    `volume`, m^3, is that of the bulge, and `gradient` (3, n), m^2, its derivative by the
    coefficients. `elastic` (3, n), N, are the elastic generalized forces, and `stretch` the factor
    on the pre-stretch."""

    c: Array
    scale: float
    volume: float
    gradient: Array
    elastic: Array
    stretch: float = 1.0


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Factorized tangent stiffness of `membrane`. `factor` is the Cholesky factor of the band at
    constant pressure. The gas adds -`fraction` w w^T to the inverse, w = `softened` (3 n,)."""

    membrane: SplineMembrane
    factor: Array
    softened: Array
    fraction: float

    def solve(self, forces: Array) -> Array:
        """Solve for the displacements (3, n), m, under generalized forces (3, n), N, to first
        order."""
        out = np.empty_like(forces)
        kernel("spline_solve")(
            *self.membrane.shape, self.factor, self.softened, self.fraction, forces, out
        )
        return out


class SplineMembrane:
    """Operators of one sensor's membrane on `spans` (x, y) spline intervals. `scale` multiplies
    Young's modulus, `stretch` the pre-stretch. `cells` (qx, qy), m^2, are the areas of the Gauss
    points in the membrane's own coordinates. `weights` are those on the mounted membrane. Raises
    InputError for too few intervals."""

    def __init__(self, design: SensorDesign, spans: tuple[int, int]):
        if min(spans) < FEWEST_SPANS:
            raise InputError(
                f"{spans}: at least {FEWEST_SPANS} intervals are needed along each side",
                source="settings",
                field="inverse.spans",
            )
        self.design = design
        self.axes = ax, ay = (
            Cubic(design.frame.length, spans[0], _GAUSS),
            Cubic(design.frame.width, spans[1], _GAUSS),
        )
        self.shape = (ax.count, ay.count)
        self.count = ax.count * ay.count
        self.cells = np.outer(ax.weights, ay.weights)
        self.weights = self.cells
        self._turns = None
        if design.frame.outline is not None:
            self._turns = self._map_derivatives(product(ax.points, ay.points))
            self.weights = self.cells * self._turns[..., 4].reshape(self.cells.shape)
        # values of the splines at the Gauss points, then slopes
        self._up_x = np.concatenate([ax.at(ax.points, 0), ax.at(ax.points, 1)])
        self._up_y = np.concatenate([ay.at(ay.points, 0), ay.at(ay.points, 1)]).T.copy()
        membrane = design.membrane
        self.law = law = ConstitutiveLaw(membrane)
        constants = np.array([ax.length, ay.length, membrane.pre_stretch**2, *law.parameters])
        # as kernels take them
        self.constants = constants
        turns = None if self._turns is None else np.ascontiguousarray(self._turns)
        self._table = (law.table.shape[1], law.table, turns)
        self.width = 9 * ay.count + 11  # of the stiffness's band

    # -- positions

    def basis(self, parametric: Array) -> Array:
        """Return the spline values (N, n) at the membrane's parametric coordinates (N, 2), m."""
        ax, ay = self.axes
        return _products(ax.at(parametric[:, 0]), ay.at(parametric[:, 1]))

    def slopes(self, parametric: Array) -> tuple[Array, Array]:
        """Return the spline derivatives (N, n) by X and by Y, 1/m, at parametric coordinates."""
        ax, ay = self.axes
        x, y = parametric.T
        by_x = _products(ax.at(x, 1), ay.at(y))
        by_y = _products(ax.at(x), ay.at(y, 1))
        if self._turns is None:
            return by_x, by_y
        (xX, xY), (yX, yY) = self.turns(parametric).transpose(1, 2, 0)[..., None]
        return xX * by_x + yX * by_y, xY * by_x + yY * by_y

    def parametric(self, X: Array) -> Array:
        """Return the parametric coordinates (N, 2), m, of positions X (N, 2), m, on the mounted
        membrane."""
        outline = self.design.frame.outline
        return X if outline is None else outline.square(X) * self._half

    def positions(self, parametric: Array) -> Array:
        """Return the positions (N, 2), m, on the mounted membrane at parametric coordinates (N, 2),
        m."""
        outline = self.design.frame.outline
        return parametric if outline is None else outline.plane(parametric / self._half)

    def turns(self, parametric: Array) -> Array:
        """Return the derivatives (N, 2, 2) of the parametric coordinates by X and Y."""
        outline = self.design.frame.outline
        if outline is None:
            return np.broadcast_to(np.eye(2), (len(parametric), 2, 2))
        return np.linalg.inv(outline.jacobian(parametric / self._half) / self._half)

    def density(self, parametric: Array) -> Array:
        """Return the ratio (N,) of area on the mounted membrane to area in parametric
        coordinates."""
        return 1 / np.linalg.det(self.turns(parametric))

    @property
    def _half(self) -> Array:
        return np.array([axis.length for axis in self.axes]) / 2

    def _map_derivatives(self, parametric: Array) -> Array:
        """Return the map's derivatives and area ratio (N, 5) in the kernels' layout."""
        return np.column_stack([self.turns(parametric).reshape(-1, 4), self.density(parametric)])

    # -- one state

    def state(
        self, c: Array, scale: float = 1.0, faded: Array | None = None, stretch: float = 1.0
    ) -> State:
        """Compute the state of the membrane at coefficients `c` (3, n), m. Its relaxed stress
        `faded` (3, qx, qy), N/m, is subtracted."""
        elastic = np.empty_like(c)
        gradient = np.empty_like(c)
        volume = np.empty(1)
        law = self._law(stretch)
        kernel("spline_state")(*self.shape, *law, c, scale, elastic, gradient, volume)
        if faded is not None:
            elastic -= self.forces_of(c, faded)
        return State(c, scale, float(volume[0]), gradient, elastic, stretch)

    def _law(self, stretch: float) -> tuple[Array, int, Array, Array | None]:
        """Return the constitutive law as kernel arguments."""
        constants = self.constants.copy()
        constants[2] *= stretch**2
        return (constants, *self._table)

    def stress(self, c: Array) -> Array:
        """Return the second Piola-Kirchhoff stress (3, qx, qy), N/m, at the Gauss points: S11, S22,
        S12."""
        g1, g2 = self._tangents(c)
        stretch2 = self.design.membrane.pre_stretch**2
        # right Cauchy-Green tensor relative to the unstretched membrane
        C11 = stretch2 * np.einsum("kxy,kxy->xy", g1, g1)
        C22 = stretch2 * np.einsum("kxy,kxy->xy", g2, g2)
        C12 = stretch2 * np.einsum("kxy,kxy->xy", g1, g2)
        return self.law.stress(C11, C22, C12)

    def forces_of(self, c: Array, stress: Array) -> Array:
        """Compute the generalized forces (3, n), N, of a membrane stress at `c` (Eq. F3). The
        stress (3, qx, qy) is in N/m."""
        qx, qy = self.weights.shape
        g1, g2 = self._tangents(c)
        S11, S22, S12 = stress * self.weights
        P1 = S11 * g1 + S12 * g2
        P2 = S12 * g1 + S22 * g2
        if self._turns is not None:
            xX, xY, yX, yY, _ = self._turns.T.reshape(5, qx, qy)
            P1, P2 = P1 * xX + P2 * xY, P1 * yX + P2 * yY
        value_x = self._up_x[:qx]
        slope_x = self._up_x[qx:]
        value_y = self._up_y[:, :qy]
        slope_y = self._up_y[:, qy:]
        along = slope_x.T @ P1 @ value_y.T
        across = value_x.T @ P2 @ slope_y.T
        return (along + across).reshape(3, self.count)

    def _tangents(self, c: Array) -> tuple[Array, Array]:
        """Return dx/dX and dx/dY (3, qx, qy) at the Gauss points."""
        qx, qy = self.weights.shape
        # (3, 2 qx, 2 qy): value and slope along x, y
        up = self._up_x @ c.reshape(3, *self.shape) @ self._up_y
        g1 = up[:, qx:, :qy]
        g2 = up[:, :qx, qy:]
        if self._turns is not None:
            xX, xY, yX, yY, _ = self._turns.T.reshape(5, qx, qy)
            g1, g2 = xX * g1 + yX * g2, xY * g1 + yY * g2
        g1[0] += 1
        g2[1] += 1
        return g1, g2

    def mean_strain(self, c: Array) -> float:
        """Return the strain of the mounted membrane, averaged over its area and both directions."""
        g1, g2 = self._tangents(c)
        longer = sum(float((np.linalg.norm(g, axis=0) * self.weights).sum()) for g in (g1, g2))
        return longer / (2 * float(self.weights.sum())) - 1

    def area_vector(self, c: Array, weight: Array) -> Array:
        """Sum the area vectors dx/dX cross dx/dY at the Gauss points, times `weight` (qx, qy), to
        (3,)."""
        g1, g2 = self._tangents(c)
        M = (g1 * weight).reshape(3, -1) @ g2.reshape(3, -1).T
        return np.array([M[1, 2] - M[2, 1], M[2, 0] - M[0, 2], M[0, 1] - M[1, 0]])

    @staticmethod
    def residual(state: State, gauge_pressure: float) -> Array:
        """Return the generalized forces (3, n), N, that hold the state: elastic minus gas (Eq. F9).
        They are zero in equilibrium."""
        return state.elastic - gauge_pressure * state.gradient

    def tangent(self, state: State, gauge_pressure: float) -> Array:
        """Compute d(residual)/dc at constant pressure, N/m (Eq. F10). The result is the lower band
        (3 n, stride) in the format of kernels/band_cholesky_f64.h. The three components of a spline
        are stored together."""
        band = np.empty((3 * self.count, band_stride(self.width)))
        law = self._law(state.stretch)
        kernel("spline_tangent")(*self.shape, *law, state.c, state.scale, gauge_pressure, band)
        return band

    # -- equilibrium

    def gas_pressure(self, state: State, gas: Gas) -> tuple[float, float]:
        """Return the gauge pressure, Pa, and the stiffness -dp/dV, Pa/m^3, of the gas in this
        state."""
        chamber = self.design.chamber
        volume = self.design.chamber_volume_flat + state.volume
        pressure = gas.pressure_at(volume, chamber.ambient, chamber.polytropic_exponent)
        return pressure, gas.stiffness(volume, chamber.polytropic_exponent)

    def seal(self, state: State, gauge_pressure: float) -> Gas:
        """Return the sealed gas with this gauge pressure, Pa, in this state."""
        chamber = self.design.chamber
        volume = self.design.chamber_volume_flat + state.volume
        return Gas(
            gauge_pressure, (chamber.ambient + gauge_pressure) * volume**chamber.polytropic_exponent
        )

    def linearise(self, state: State, gas: Gas) -> tuple[Array, Stiffness]:
        """Compute the residual (3, n) and its factorized tangent, gas stiffness included. Wrinkles
        can make the membrane's own tangent indefinite. Then it is shifted toward the identity until
        it is positive definite. Raises MjtactileError if a value of the state is not finite."""
        pressure, gas_stiffness = self.gas_pressure(state, gas)
        stiffness = self.factorized(self.tangent(state, pressure), state, gas_stiffness)
        return self.residual(state, pressure), stiffness

    def factorized(self, band: Array, state: State, gas_stiffness: float) -> Stiffness:
        """Factorize the tangent `band` in place. The gas with `gas_stiffness`, Pa/m^3, is added.
        Raises MjtactileError if a value is not finite."""
        softened = np.empty(3 * self.count)
        try:
            kernel("factor_definite")(len(band), self.width, band)
        except np.linalg.LinAlgError:
            raise MjtactileError(
                f"sensor {self.design.name}: the membrane's stiffness is not finite; check "
                "the sensor file, the pressure and the markers"
            ) from None
        fraction = kernel("soften")(*self.shape, band, state.gradient, gas_stiffness, softened)
        return Stiffness(self, band, softened, fraction)

    def equilibrium(
        self,
        gas: Gas,
        scale: float = 1.0,
        load: Array | None = None,
        start: Array | None = None,
        faded: Array | None = None,
        stretch: float = 1.0,
    ) -> Array:
        """Compute the coefficients (3, n) at equilibrium by Newton steps from `start`. The membrane
        is under `gas` and generalized loads (3, n), N. `faded` is the same as for `state`. Raises
        MjtactileError if no equilibrium is found (a design that cannot hold its own pressure)."""
        c: Array = np.zeros((3, self.count)) if start is None else start.copy()
        for _ in range(_NEWTON_STEPS):
            residual, stiffness = self.linearise(self.state(c, scale, faded, stretch), gas)
            if load is not None:
                residual = residual - load.reshape(3, -1)
            step = stiffness.solve(residual)
            largest = float(np.abs(step).max())
            c -= min(1.0, _STEP_MAX / max(largest, 1e-30)) * step
            if largest < _CONVERGED:
                return c
        raise MjtactileError(
            f"sensor {self.design.name}: no equilibrium of the membrane was found at "
            f"{gas.gauge_pressure:g} Pa"
        )


def _products(along: Array, across: Array) -> Array:
    """Return the tensor products (N, n) of splines along x (N, kx) and y (N, ky), y fastest."""
    return (along[:, :, None] * across[:, None, :]).reshape(len(along), -1)


def product(x: Array, y: Array) -> Array:
    """Return all pairs (len(x) len(y), 2), y fastest."""
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
