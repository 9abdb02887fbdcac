"""Membrane shape from marker poses: a smoothing spline fitted directly to the markers.

`SurfaceFitter`: a tensor-product cubic B-spline z(x, y) over the frame's opening. The boundary
coefficients are left out, so that z is exactly zero on the frame. Its coefficients c minimize

    sum ((z(x_i, y_i) - z_i) / sd_i)^2 + sum |(grad z - slope_i) / sd_slope_i|^2
        + integral (|grad lap z| / g)^2 / A + integral (lap z / k)^2 / A

The third term is the membrane's physics. A membrane of uniform tension under uniform pressure has a
constant Laplacian outside the contact (Young-Laplace). So inflation is not penalized. Under a
sphere the Laplacian is constant again (2 / R). `g` is the expected rms gradient of the Laplacian,
which comes from contact edges. A is the opening's area. The fourth term only keeps the fit finite
if markers are missing. In the Gaussian process interpretation, the inverse Hessian is the
coefficients' covariance. The uncertainties of heights, area and volume follow from it.

For an opening that is not rectangular, the splines cover its bounding rectangle. They cover two
more intervals on each side. So the surface may leave the outline with any slope. Integrals are over
the opening. On its outline z is zero to `_RIM_SD`, as if measured there. Beyond the outline the
fourth term, much weakened, keeps the fit finite.

The arithmetic is in mjtactile/kernels/smoothing_spline.c. The Hessian is banded, because splines
overlap only their neighbors.

The paper's own method is in `benchmarks/perception/delaunay.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core import geometry
from mjtactile.core.bspline import Cubic
from mjtactile.core.design import SensorDesign
from mjtactile.core.sensor_parts import Frame
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import Array, Markers, Surface
from mjtactile.kernels import band_stride, kernel
from mjtactile.sensing.settings import DEFAULTS, SurfaceSettings

GRID_STEP = 1e-3
"""Largest spacing of the height grid, m."""
# nodes in each interval: exact for products of two splines' derivatives up to degree 5, of two
# cubics to 1e-6
GAUSS = 4
_MARGIN = 4  # intervals beyond an outline, on both sides together
_RIM_SD = 20e-6  # sd of the rim's height, m; a smaller value bends the splines at the outline
_RIM_POINTS = 4  # rim points per interval of the longer side
_BEYOND = 1e-4  # weight beyond the outline, as a fraction of the fourth term's
_BENT = (((2, 0), (0, 2)),)  # the Laplacian, squared by `_energy`


@dataclass(frozen=True, eq=False)
class Spline:
    """A fitted surface in S, zero on the frame. `coefficients` (ny, nx) m are those of z(x, y) =
    sum B_j(y) c_ji B_i(x)."""

    fitter: SurfaceFitter
    coefficients: Array
    factor: Array  # lower band factor of the inverse covariance, before `misfit`; see `banded`
    misfit: float  # factor on the covariance, at least 1: mean square of residuals over their sd
    status: Status

    def evaluate(self, x: ArrayLike, y: ArrayLike, dx: int = 0, dy: int = 0) -> Array:
        """Evaluate z, m, or its derivative of order (dx, dy), at points `x`, `y` (N,), m."""
        across = self.fitter.basis_x.at(x, dx)
        down = self.fitter.basis_y.at(y, dy)
        return ((down @ self.coefficients) * across).sum(axis=1)

    def normals(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the unit normals (N, 3) towards the camera at points `x`, `y` (N,), m."""
        return geometry.normal_from_slope(self.evaluate(x, y, 1, 0), self.evaluate(x, y, 0, 1))

    def grid(self, dx: int = 0, dy: int = 0) -> Array:
        """Return z, m, or its derivative of order (dx, dy), on the fitter's grid (ny, nx)."""
        return self.fitter.grid_y[dy] @ self.coefficients @ self.fitter.grid_x[dx].T

    def height_sd(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the standard deviation (N,), m, of z at points `x`, `y` (N,), m."""
        from scipy.linalg import solve_banded  # takes a while to import

        rows = self.fitter.rows(x, y)
        width = self.fitter.width
        half = solve_banded((width, 0), self.factor.T[: width + 1], rows.T)
        return np.sqrt(self.misfit * (half**2).sum(axis=0))

    def surface(self) -> Surface:
        """Compute heights on the grid, area and volume by Gauss quadrature, and their uncertainties
        to first order."""
        f = self.fitter
        ny, nx = self.coefficients.shape
        z = np.empty((len(f.y), len(f.x)))
        sums = np.empty(4)
        spline = (nx, ny, self.coefficients, self.factor, self.misfit)
        kernel("measure_surface")(*spline, len(f.x), len(f.y), *f.tables, z, sums)
        area, volume, area_sd, volume_sd = sums.tolist()
        if f.outside is not None:
            z[f.outside] = 0.0
        return Surface(f.x, f.y, z, area, volume, area_sd, volume_sd, self.status)


class SurfaceFitter:
    """Spline fitter of one sensor; keeps the tables that are the same for all images. The settings'
    `roughness`, 1/m^2, and `laplacian`, 1/m, are the g and k of the module's docstring. The number
    of spline intervals exceeds the markers in a row by two or three. It is at least 8 and even. So
    a knot lies in the center, where contacts are typical. This halves the errors under a sphere."""

    def __init__(self, design: SensorDesign, settings: SurfaceSettings = DEFAULTS.surface):
        self.settings = settings
        frame = design.frame
        layout = design.markers
        nx, ny = (max(8, n + 2 + n % 2) for n in (layout.columns, layout.rows))
        more = 0 if frame.outline is None else _MARGIN
        length = frame.length * (1 + more / nx)
        width = frame.width * (1 + more / ny)
        self.basis_x = Cubic(length, nx + more, GAUSS)
        self.basis_y = Cubic(width, ny + more, GAUSS)
        self.width = 3 * self.basis_x.count + 3
        self.x, self.y = grid_of(frame)
        self.grid_x = [self.basis_x.at(self.x, d) for d in range(3)]
        self.grid_y = [self.basis_y.at(self.y, d) for d in range(3)]
        if frame.outline is None:  # exactly, not only to rounding
            self.grid_x[0][[0, -1]] = self.grid_y[0][[0, -1]] = 0.0
        self._quad = (_derivatives(self.basis_x), _derivatives(self.basis_y))
        everywhere = self.basis_y.weights[:, None] * self.basis_x.weights
        weights = everywhere * self._fraction_inside(frame)
        inside = None if frame.outline is None else weights
        self.tables = self._tables(weights, inside)
        self.prior = self._prior(frame, inside)
        self.outside = None
        if frame.outline is not None:
            rim = self.rows(*frame.outline.points(_RIM_POINTS * 2 * max(nx, ny)).T)
            self.prior += rim.T @ rim / _RIM_SD**2
            beyond = self._energy(everywhere - weights, *_BENT)
            self.prior += _BEYOND * beyond / settings.laplacian**2 / frame.area
            nodes = np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)
            self.outside = (frame.inside(nodes) <= 0).reshape(len(self.y), len(self.x))
        self._prior_band = banded(self.prior, self.width)
        # half a pitch of a curvature k / 2
        slope_off = settings.laplacian / 4 * max(layout.pitch_x, layout.pitch_y)
        s = settings
        slopes = [s.slope_model_sd, s.slope_sd_max, slope_off]
        outliers = [s.outlier_sd, s.outlier_min, s.outliers_leave]
        self._numbers = np.array([length, width, design.camera.distance, *slopes, *outliers])

    def _tables(self, weights: Array, inside: Array | None) -> tuple[object, ...]:
        """Return the tables with which the kernel measures a surface. The Gauss points have
        `weights` (qy, qx) m^2. `inside` is an outline; None: the rectangle."""
        quad_x, quad_y = self._quad
        return (
            np.ascontiguousarray(self.grid_x[0].T),
            self.grid_y[0],
            len(self.basis_x.weights),
            len(self.basis_y.weights),
            np.stack([quad_x[0].T, quad_x[1].T]),
            np.stack(quad_y[:2]),
            weights,
            quad_y[0].T @ weights @ quad_x[0],  # of the volume by the coefficients
            banded(self._energy(inside, ((1, 0),), ((0, 1),)), self.width),
        )

    def _prior(self, frame: Frame, inside: Array | None) -> Array:
        """Return the third and fourth term of the module's docstring as a matrix of the
        coefficients."""
        settings = self.settings
        rough = self._energy(inside, ((3, 0), (1, 2)), ((2, 1), (0, 3)))
        bent = self._energy(inside, *_BENT)
        rough /= settings.roughness**2 * frame.area
        return rough + bent / (settings.laplacian**2 * frame.area)

    def fit(self, markers: Markers, *, normals: bool = True) -> Surface:
        """Fit the surface to identified markers. See `fit_spline`."""
        n_S = markers.n_S if normals else None
        return self.fit_spline(markers.p_SM, markers.cov_p, n_S).surface()

    def fit_spline(
        self, p_SM: ArrayLike, cov_p: ArrayLike | None = None, n_S: ArrayLike | None = None
    ) -> Spline:
        """Fit markers at `p_SM` (N, 3), m, with covariance `cov_p` (N, 3, 3), m^2, in S.

        The default covariance is that of 10 um. With normals `n_S` (N, 3) of either sign, their
        slopes also contribute if accurate enough. `slope_sd_of` is evaluated at the tilts of a
        first fit without slopes. The measured tilts would favor their own errors. A marker is left
        out if it is not finite, or far off the surface of the others.
        """
        p = np.asarray(p_SM, dtype=float).reshape(-1, 3)
        if cov_p is None:
            variance = np.full(len(p), 1e-10)
        else:
            variance = np.asarray(cov_p, dtype=float)[:, 2, 2]
        c = np.empty((self.basis_y.count, self.basis_x.count))
        factor = np.empty_like(self._prior_band)
        sums = np.empty(2)
        # the prior is positive definite: only absurd weights make the normal equations not so
        spline = (self.basis_x.count, self.basis_y.count, self._numbers, self._prior_band)
        kernel("fit_surface")(len(p), p, variance, n_S, *spline, c, factor, sums)
        misfit, markers = sums.tolist()
        status = check_markers(int(markers), self.settings.markers_min)
        return Spline(self, c, factor, misfit, status)

    def rows(self, x: ArrayLike, y: ArrayLike, dx: int = 0, dy: int = 0) -> Array:
        """Return the design matrix (N, ny * nx) at `x`, `y` (N,), m. It is z or its derivative of
        order (dx, dy) per coefficient."""
        return _products(self.basis_y.at(y, dy), self.basis_x.at(x, dx))

    def _fraction_inside(self, frame: Frame) -> Array:
        """Return the fraction (qy, qx) of each Gauss point's area that is inside the opening."""
        x, y = self.basis_x, self.basis_y
        if frame.outline is None:
            return np.ones((len(y.points), len(x.points)))
        points = np.stack(np.meshgrid(x.points, y.points), axis=-1).reshape(-1, 2)
        across = np.sqrt(x.length / len(x.points) * y.length / len(y.points))
        fraction = np.clip(0.5 + frame.inside(points) / across, 0.0, 1.0)
        fraction = fraction.reshape(len(y.points), len(x.points))
        cut = fraction * (1 - fraction)
        lacking = frame.area - float(y.weights @ fraction @ x.weights)
        return fraction + cut * (lacking / float(y.weights @ cut @ x.weights))

    def _energy(self, weights: Array | None, *terms: tuple[tuple[int, int], ...]) -> Array:
        """Return the matrix of the integral of sum over `terms` of (d1 z + d2 z + ...)^2. Each d is
        an order of derivative (x, y). The Gauss points have `weights` (qy, qx) m^2; None: those of
        the rectangle."""
        if weights is not None:
            quad_x, quad_y = self._quad
            at = weights.ravel()[:, None]
            summed = np.zeros((self.basis_x.count * self.basis_y.count,) * 2)
            for pair in terms:
                rows = np.add.reduce([np.kron(quad_y[b], quad_x[a]) for a, b in pair])
                summed += rows.T @ (at * rows)
            return summed
        wx = self.basis_x.weights
        wy = self.basis_y.weights

        def gram(tables: list[Array], w: Array, a: int, b: int) -> Array:
            return tables[a].T @ (w[:, None] * tables[b])

        total = np.zeros((self.basis_x.count * self.basis_y.count,) * 2)
        for pair in terms:
            for ax, ay in pair:
                for bx, by in pair:
                    along_y = gram(self._quad[1], wy, ay, by)
                    total += np.kron(along_y, gram(self._quad[0], wx, ax, bx))
        return total


def _derivatives(basis: Cubic) -> list[Array]:
    """Return the splines and their first three derivatives at their Gauss points."""
    return [basis.at(basis.points, d) for d in range(4)]


def banded(matrix: Array, width: int) -> Array:
    """Return the lower triangle of a symmetric banded `matrix` (n, n) in band storage (n,
    stride)."""
    band = np.zeros((len(matrix), band_stride(width)))
    for below in range(min(width + 1, len(matrix))):
        band[: len(matrix) - below, below] = np.diagonal(matrix, -below)
    return band


def grid_of(frame: Frame, step: float = GRID_STEP) -> tuple[Array, Array]:
    """Return grid lines x (nx,), y (ny,), m, over the opening, frame included, at most `step`
    apart."""
    nx, ny = (int(np.ceil(size / step - 1e-9)) + 1 for size in (frame.length, frame.width))
    x = np.linspace(-frame.length / 2, frame.length / 2, nx)
    return x, np.linspace(-frame.width / 2, frame.width / 2, ny)


def check_markers(markers: int, minimum: int) -> Status:
    """Return the status OK for at least `least` markers, else TOO_FEW_MARKERS."""
    if markers >= minimum:
        return OK
    text = f"too few markers: {markers}; at least {minimum} are needed"
    return Status(StatusCode.TOO_FEW_MARKERS, text)


def _products(down: Array, across: Array) -> Array:
    """Return the row-wise Kronecker product (N, ny * nx) of (N, ny) and (N, nx)."""
    products = down[:, :, None] * across[:, None, :]
    return products.reshape(len(down), down.shape[1] * across.shape[1])
