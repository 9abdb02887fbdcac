"""The membrane by products of small matrices and dense factors: sensing/force/spline_fem.py in
numpy. Stiffness and residual are component by component, (3 n, 3 n) and (3, n)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor

from mjtactile.core.bspline import Cubic
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.constitutive_law import ConstitutiveLaw
from mjtactile.sensing.force.spline_fem import Gas

# nodes in each interval of the spline: the integrands vary over markers, several intervals wide
_GAUSS = 2
# blocks of the lower triangle
_LOWER = (np.array([0, 1, 2, 1, 2, 2]), np.array([0, 1, 2, 0, 0, 1]))
_MIXED = slice(3, 6)  # those of them off the diagonal
# of the mean diagonal: how far an indefinite stiffness (wrinkles) is pushed, tenfold until it is
# definite
_NUDGE = 1e-3


@dataclass(frozen=True, eq=False)
class State:
    """Deformation at the Gauss points.

    Positions `x` (3, qx, qy) m. Tangents `g1`, `g2` = dx/dX, dx/dY. Area vector `normal` = g1 cross
    g2. Second Piola-Kirchhoff force `S` (3, qx, qy) = S11, S22, S12 N/m. Bulge `volume` m^3. The
    `strain` (3, qx, qy) = C11, C22, C12 relative to the free membrane, for the moduli, which
    `scale` multiplies.
    """

    x: Array
    g1: Array
    g2: Array
    normal: Array
    S: Array
    volume: float
    strain: Array
    scale: float


class SplineMembrane:
    """Operators of one sensor's membrane on `spans` (x, y) spline intervals. `scale` multiplies
    Young's modulus."""

    def __init__(self, design: SensorDesign, spans: tuple[int, int]):
        design.require_rectangle("inverse finite elements")
        self.design = design
        self.axes = ax, ay = (
            Cubic(design.frame.length, spans[0], _GAUSS),
            Cubic(design.frame.width, spans[1], _GAUSS),
        )
        self.shape = (ax.count, ay.count)
        self.count = ax.count * ay.count
        self.weights = np.outer(ax.weights, ay.weights)
        self._bx, self._by = ([a.at(a.points, k) for k in (0, 1)] for a in (ax, ay))
        self._up_x, self._up_y = np.concatenate(self._bx), np.concatenate(self._by).T.copy()
        (rows_x, columns_x), (rows_y, columns_y) = (_overlapping(a.count) for a in self.axes)
        self._px = {
            (k, m): (self._bx[k][:, rows_x] * self._bx[m][:, columns_x]).T.copy()
            for k in (0, 1)
            for m in (0, 1)
        }
        self._py = {
            (k, m): self._by[k][:, rows_y] * self._by[m][:, columns_y]
            for k in (0, 1)
            for m in (0, 1)
        }
        i, j = (block[:, None, None] * self.count for block in _LOWER)
        row = i + rows_x[:, None] * ay.count + rows_y
        self._places = (
            row * 3 * self.count + j + columns_x[:, None] * ay.count + columns_y
        ).ravel()
        rubber = design.membrane
        self._law = ConstitutiveLaw(rubber)
        self._lambda2 = rubber.pre_stretch**2

    # -- one state
    # --------------------------------------------------------------------------------

    def state(self, c: Array, scale: float = 1.0) -> State:
        """Return the state at the Gauss points for coefficients `c` (3, n), m."""
        x, g1, g2 = self._positions(c)
        normal = _cross(g1, g2)
        C = self._lambda2 * np.stack([(a * b).sum(0) for a, b in ((g1, g1), (g2, g2), (g1, g2))])
        return State(
            x,
            g1,
            g2,
            normal,
            scale * self._law.stress(*C),
            float((self.weights * x[2] * normal[2]).sum()),
            C,
            scale,
        )

    def _positions(self, c: Array) -> tuple[Array, Array, Array]:
        """Return positions and tangents (3, qx, qy) at the Gauss points."""
        qx, qy = self.weights.shape
        # (3, 2 qx, 2 qy): value and slope along x, y
        up = self._up_x @ c.reshape(3, *self.shape) @ self._up_y
        x = up[:, :qx, :qy]
        g1 = up[:, qx:, :qy]
        g2 = up[:, :qx, qy:]
        ax, ay = self.axes
        x[0] += ax.points[:, None]
        x[1] += ay.points
        g1[0] += 1
        g2[1] += 1
        return x, g1, g2

    def residual(self, state: State, gauge_pressure: float) -> Array:
        """Return generalised forces (3, n), N, in equilibrium with the state: elastic minus gas
        (Eq. F9); zero at rest."""
        S11, S22, S12 = state.S
        P1 = S11 * state.g1 + S12 * state.g2
        P2 = S12 * state.g1 + S22 * state.g2
        return self._dual(-gauge_pressure * state.normal, P1, P2)

    def volume_gradient(self, state: State) -> Array:
        """Return dV/dc (3, n), m^2."""
        return self._integrate(state.normal, 0, 0)

    def tangent(self, state: State, gauge_pressure: float) -> Array:
        """Return d(residual)/dc at constant pressure (3 n, 3 n) N/m, its lower triangle of 3 x 3
        blocks only (Eq. F10)."""
        g1, g2, (S11, S22, S12), w = state.g1, state.g2, state.S, self.weights
        D11, D22, D12, D16, D26, D66 = state.scale * self._lambda2 * self._law.moduli(*state.strain)
        i, j = _LOWER
        same = (i == j)[:, None, None]
        # dP_a,i/dg_b,j = S_ab d_ij + D_acbd g_c,i g_d,j
        one = g1[i] * g1[j]
        two = g2[i] * g2[j]
        mixed = g1[i] * g2[j]
        crossed = g2[i] * g1[j]
        both = mixed + crossed
        sides = D16 * one + D26 * two
        K = self._pairs(w * (D11 * one + D66 * two + D16 * both + same * S11), (1, 1), (0, 0))
        K += self._pairs(w * (D22 * two + D66 * one + D26 * both + same * S22), (0, 0), (1, 1))
        K += self._pairs(w * (D12 * mixed + D66 * crossed + sides + same * S12), (1, 0), (0, 1))
        K += self._pairs(w * (D12 * crossed + D66 * mixed + sides + same * S12), (0, 1), (1, 0))
        # gas: d(g1 x g2) = du,1 x g2 + g1 x du,2; component k of the tangents enters block i, j
        # with the sign of ijk
        third = np.array([2, 1, 0])  # of the blocks (1, 0), (2, 0), (2, 1)
        push = gauge_pressure * w * np.array([1.0, -1.0, 1.0])[:, None, None]
        K[_MIXED] += self._pairs(push * g2[third], (0, 1), (0, 0)) - self._pairs(
            push * g1[third], (0, 0), (0, 1)
        )
        full = np.zeros(9 * self.count**2)
        full[self._places] = K.ravel()
        return full.reshape(3 * self.count, 3 * self.count)

    def _pairs(self, values: Array, along_x: tuple[int, int], along_y: tuple[int, int]) -> Array:
        """Return integrals of `values` (..., qx, qy) times pairs of splines, or of their slopes,
        that overlap."""
        return self._px[along_x] @ values @ self._py[along_y]

    def _integrate(self, values: Array, along_x: int, along_y: int) -> Array:
        return (self._bx[along_x].T @ (self.weights * values) @ self._by[along_y]).reshape(3, -1)

    def _dual(self, value: Array, slope_x: Array, slope_y: Array) -> Array:
        return (
            self._integrate(value, 0, 0)
            + self._integrate(slope_x, 1, 0)
            + self._integrate(slope_y, 0, 1)
        )

    def gas_pressure(self, state: State, gas: Gas) -> tuple[float, float]:
        """Return gauge pressure, Pa, and stiffness -dp/dV, Pa/m^3, of the gas in this state."""
        chamber = self.design.chamber
        volume = self.design.chamber_volume_flat + state.volume
        return (
            gas.pressure_at(volume, chamber.ambient, chamber.polytropic_exponent),
            gas.stiffness(volume, chamber.polytropic_exponent),
        )

    def linearise(self, state: State, gas: Gas) -> tuple[Array, tuple[Array, bool]]:
        """Return residual (3 n,) and the Cholesky factor of its tangent, gas stiffness included."""
        pressure, stiffness = self.gas_pressure(state, gas)
        K = self.tangent(state, pressure)
        if stiffness:
            gradient = self.volume_gradient(state).ravel()
            K += stiffness * gradient[:, None] * gradient
        return self.residual(state, pressure).ravel(), definite_factor(K)


def _cross(a: Array, b: Array) -> Array:
    """Return vector products (3, ...)."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _overlapping(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return index pairs of the cubic splines whose supports overlap."""
    index = np.arange(count)
    near = np.abs(index[:, None] - index) <= 3
    rows, columns = np.nonzero(near)
    return rows, columns


def definite_factor(K: Array) -> tuple[Array, bool]:
    """Return the Cholesky factor of K, shifted towards the identity if K is not positive
    definite."""
    push = 0.0
    while True:
        try:
            return cho_factor(
                (K if push == 0.0 else K + push * np.eye(len(K))).T, check_finite=False
            )
        except np.linalg.LinAlgError:
            push = max(10 * push, _NUDGE * float(np.trace(K)) / len(K))
