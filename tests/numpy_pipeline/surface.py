"""The smoothing spline by dense normal equations: sensing/surface/surface.py in numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from mjtactile.core import geometry
from mjtactile.core.bspline import Cubic
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.force.slopes import slope_sd
from mjtactile.sensing.settings import DEFAULTS, SurfaceSettings
from mjtactile.sensing.surface.surface import grid_of

_GAUSS = 4


@dataclass(frozen=True, eq=False)
class Measured:
    """Heights on the grid, area, volume, and their standard deviations."""

    z: Array
    area: float
    volume: float
    area_sd: float
    volume_sd: float


@dataclass(frozen=True, eq=False)
class Spline:
    """A fitted surface."""

    fitter: SurfaceFitter
    coefficients: Array
    # lower triangular factor of the coefficients' inverse covariance, before `misfit`
    cholesky: Array
    misfit: float
    markers: int

    def surface(self) -> Measured:
        """Return heights on the grid, area and volume by Gauss quadrature, and their uncertainties
        to first order."""
        f = self.fitter
        c = self.coefficients
        z_x = f.quad_y[0] @ c @ f.quad_x[1].T
        z_y = f.quad_y[1] @ c @ f.quad_x[0].T
        stretch = np.sqrt(1 + z_x * z_x + z_y * z_y)
        area_c = (
            f.quad_y[0].T @ (f.weights * z_x / stretch) @ f.quad_x[1]
            + f.quad_y[1].T @ (f.weights * z_y / stretch) @ f.quad_x[0]
        )
        gradients = f.gradients.copy()
        gradients[:, -2] = area_c.ravel()
        half, _ = lapack.strtrs(
            self.cholesky.astype(np.float32), gradients, lower=True, overwrite_b=True
        )
        *rough, area_var, volume_var = np.einsum("ij,ij->j", half, half).tolist()
        # noise makes a flat membrane's area larger, to second order: E = trace(stiffness
        # covariance) / 2
        rough = sum(rough) / 2
        area_sd, volume_sd = (
            float(np.sqrt(self.misfit * v)) for v in (area_var + rough**2, volume_var)
        )
        z = f.grid_y @ c @ f.grid_x.T
        return Measured(
            z, float((f.weights * stretch).sum()), float((f.volume_c * c).sum()), area_sd, volume_sd
        )


@dataclass(frozen=True, eq=False)
class _Terms:
    """Normal equations of observations in units of their sd: A^T A, A^T b, b^T b, the number of
    rows, and of heights."""

    normal: Array
    right: Array
    square: float
    rows: int
    markers: int

    @classmethod
    def of(cls, A: Array, b: Array, *, heights: bool = True) -> _Terms:
        return cls(A.T @ A, A.T @ b, float(b @ b), len(b), len(b) if heights else 0)

    def __add__(self, other: _Terms) -> _Terms:
        return _Terms(
            self.normal + other.normal,
            self.right + other.right,
            self.square + other.square,
            self.rows + other.rows,
            self.markers + other.markers,
        )


class SurfaceFitter:
    """Surface fit of the package, in numpy."""

    def __init__(self, design: SensorDesign, settings: SurfaceSettings = DEFAULTS.surface):
        self.settings = settings
        frame = design.frame
        layout = design.markers
        self.distance = design.camera.distance
        nx, ny = (max(8, n + 2 + n % 2) for n in (layout.columns, layout.rows))
        # half a pitch of a curvature k / 2
        self.slope_off = settings.laplacian / 4 * max(layout.pitch_x, layout.pitch_y)
        self.basis_x = Cubic(frame.length, nx, _GAUSS)
        self.basis_y = Cubic(frame.width, ny, _GAUSS)
        x, y = grid_of(frame)
        self.grid_x, self.grid_y = self.basis_x.at(x), self.basis_y.at(y)
        self.quad_x, self.quad_y = (
            [a.at(a.points, d) for d in range(4)] for a in (self.basis_x, self.basis_y)
        )
        wx = self.basis_x.weights
        wy = self.basis_y.weights
        self.weights = wy[:, None] * wx
        self.volume_c = self.quad_y[0].T @ self.weights @ self.quad_x[0]
        # gradients for the covariances of `Spline.surface` (single precision suffices): slopes
        # everywhere, area, volume
        stiffness_root = np.linalg.cholesky(self._energy(wx, wy, ((1, 0),), ((0, 1),)))
        gradients = [stiffness_root, np.zeros(len(stiffness_root)), self.volume_c.ravel()]
        self.gradients = np.asfortranarray(np.column_stack(gradients), dtype=np.float32)
        area = frame.length * frame.width
        self.prior = self._energy(wx, wy, ((3, 0), (1, 2)), ((2, 1), (0, 3))) / (
            settings.roughness**2 * area
        ) + self._energy(wx, wy, ((2, 0), (0, 2))) / (settings.laplacian**2 * area)

    def fit_spline(
        self, p_SM: ArrayLike, cov_p: ArrayLike | None = None, n_S: ArrayLike | None = None
    ) -> Spline:
        """Fit a spline to marker positions, as the package's method does."""
        p = np.asarray(p_SM, dtype=float).reshape(-1, 3)
        variance = (
            np.full(len(p), 1e-10) if cov_p is None else np.asarray(cov_p, dtype=float)[:, 2, 2]
        )
        good = np.isfinite(p).all(axis=1) & (variance > 0)
        p = p[good]
        variance = variance[good]
        x, across = (self.basis_x.at(p[:, 0], d) for d in (0, 1))
        y, down = (self.basis_y.at(p[:, 1], d) for d in (0, 1))
        rows = _products(y, x)
        spline, heights, fits = self._solve_without_outliers(rows, p[:, 2], np.sqrt(variance))
        if n_S is None:
            return spline
        across = _products(y, across)
        down = _products(down, x)
        c = spline.coefficients.ravel()
        predicted = np.column_stack([across @ c, down @ c])
        sd = self._slope_sd(
            geometry.normal_from_slope(predicted[:, 0], predicted[:, 1]), p, variance
        )
        slope = geometry.slope_from_normal(np.asarray(n_S, dtype=float)[good])
        # comparisons are False for NaN: an unknown slope is not used
        use = (
            fits
            & (sd < self.settings.slope_sd_max)
            & (np.abs(slope - predicted).max(axis=1) < self.slope_off)
        )
        if not use.any():
            return spline
        over = 1 / sd[use, None]
        rows = np.concatenate([across[use] * over, down[use] * over])
        slopes = (slope[use] * over).T.ravel()
        return self._solve(heights + _Terms.of(rows, slopes, heights=False))

    def _solve_without_outliers(
        self, rows: Array, z: Array, sd: Array
    ) -> tuple[Spline, _Terms, NDArray[np.bool_]]:
        """Fit heights `z` (N,). Repeat without the worst marker while one is far from the
        prediction of all others."""
        fits = np.ones(len(z), bool)
        A = rows / sd[:, None]
        b = z / sd
        while True:
            terms = _Terms.of(A, b)
            spline = self._solve(terms)
            # leave one out: residual / (1 - leverage), variance / (1 - leverage); Cook & Weisberg
            # 1982, 2.2
            half, _ = lapack.strtrs(
                spline.cholesky.astype(np.float32),
                A.T.astype(np.float32),
                lower=True,
                overwrite_b=True,
            )
            left = np.maximum(1 - np.einsum("ij,ij->j", half, half), 1e-6)
            off = np.abs(b - A @ spline.coefficients.ravel()) / left  # in sd
            excess = np.minimum(
                off * sd[fits] / self.settings.outlier_min,
                off * np.sqrt(left) / self.settings.outlier_sd,
            )
            if (
                not len(excess)
                or excess.max() <= 1
                or len(excess) <= self.settings.outliers_leave * len(z)
            ):
                return spline, terms, fits
            worst = np.argmax(excess)
            fits[np.flatnonzero(fits)[worst]] = False
            A = np.delete(A, worst, axis=0)
            b = np.delete(b, worst)

    def _slope_sd(self, n: Array, p: Array, variance: Array) -> Array:
        return np.hypot(
            self.settings.slope_model_sd,
            slope_sd(n, p + np.array([0.0, 0.0, self.distance]), variance),
        )

    def _solve(self, terms: _Terms) -> Spline:
        cholesky, fault = lapack.dpotrf(terms.normal + self.prior, lower=True, overwrite_a=True)
        if fault:  # the prior is positive definite: only invalid weights lead here
            raise np.linalg.LinAlgError("normal equations of the surface are not positive definite")
        c, _ = lapack.dpotrs(cholesky, terms.right, lower=True)
        # features that the splines cannot follow (the edge of a contact) appear as residuals larger
        # than their noise: Birge 1932
        squares = c @ terms.normal @ c - 2 * (c @ terms.right) + terms.square
        misfit = max(1.0, squares / max(terms.rows, 1))
        return Spline(
            self, c.reshape(self.basis_y.count, self.basis_x.count), cholesky, misfit, terms.markers
        )

    def _energy(self, wx: Array, wy: Array, *terms: tuple[tuple[int, int], ...]) -> Array:
        """Return the matrix of the integral of sum over `terms` of (d1 z + d2 z + ...)^2, each d an
        order of derivative (x, y)."""

        def gram(tables: list[Array], w: Array, a: int, b: int) -> Array:
            return tables[a].T @ (w[:, None] * tables[b])

        total = np.zeros((self.basis_x.count * self.basis_y.count,) * 2)
        for pair in terms:
            for ax, ay in pair:
                for bx, by in pair:
                    total += np.kron(gram(self.quad_y, wy, ay, by), gram(self.quad_x, wx, ax, bx))
        return total


def _products(down: Array, across: Array) -> Array:
    """Return row-wise Kronecker product (N, ny * nx) of (N, ny) and (N, nx)."""
    return (down[:, :, None] * across[:, None, :]).reshape(
        len(down), down.shape[1] * across.shape[1]
    )
