"""The membrane's shape from marker poses: a smoothing spline fitted straight to the markers, and
the paper's route.

`SurfaceFitter` (default): a tensor-product cubic B-spline z(x, y) over the frame's opening whose
boundary coefficients are left out, so that it is exactly zero on the frame. Its coefficients c
minimise

    sum ((z(x_i, y_i) - z_i) / sd_i)^2 + sum |(grad z - slope_i) / sd_slope_i|^2
        + integral (|grad lap z| / g)^2 / A + integral (lap z / k)^2 / A

The third term is the membrane's physics: where nothing touches, a sheet of uniform tension under
uniform pressure has a constant Laplacian (Young-Laplace), so that inflating or pumping costs
nothing, and under a ball it is constant again (2 / R). `g` is the rms gradient of the Laplacian to
expect (contact edges make it), A the opening's area. The fourth term only keeps the fit finite
where markers are missing. Read as a Gaussian process, the inverse Hessian is the coefficients'
covariance, from which heights, area and volume get their uncertainties.

Of an opening that is no rectangle the splines cover the rectangle around it and two intervals more
on each side, so that they are free to leave it with any slope. Integrals are over the
opening, on its outline z is zero to `_RIM_SD`, as if it were measured there, and beyond it the
fourth term, much weakened, keeps the fit finite.

The arithmetic is in mjtactile/kernels/surface.c. The Hessian is a band, since splines overlap only
their neighbours.

`reconstruct_delaunay` (paper, II-B.3): Delaunay triangles of the marker centres and points on the
frame, barycentric interpolation on a Cartesian grid, B-spline surface through it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

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
_GAUSS = 4
_MARGIN = 4  # intervals beyond an outline, on both sides together
_RIM_SD = 20e-6  # m: less bends the splines where the outline crosses their cells
_RIM_POINTS = 4  # to an interval of the longer side
_BEYOND = 1e-4  # of the fourth term's weight
_ASPECT_PER_DEPTH = np.sqrt(8 / 3)
"""sd of an ellipse's axis ratio over the relative sd of its depth. With independent radial errors
along the outline the axis ratio, 1 - 2 c / r with c the second harmonic, has sqrt(8) times the mean
radius's relative sd, and the depth, whose tilt is fitted too, sqrt(3) times. Normals measured on
rendered images have 0.8 to 0.9 of the sd that follows."""


@dataclass(frozen=True, eq=False)
class Spline:
    """A fitted surface: `coefficients` (ny, nx) m of z(x, y) = sum B_j(y) c_ji B_i(x), zero on the
    frame, in S."""

    fitter: SurfaceFitter
    coefficients: Array
    # lower triangular factor of the coefficients' inverse covariance, before `misfit`: a band, see
    # `banded`
    factor: Array
    # factor on the covariance, at least 1: mean square of the residuals over their sd
    misfit: float
    status: Status

    def evaluate(self, x: ArrayLike, y: ArrayLike, dx: int = 0, dy: int = 0) -> Array:
        """z or its derivative of order (dx, dy) at points `x`, `y` (N,) m."""
        across = self.fitter.basis_x.at(x, dx)
        down = self.fitter.basis_y.at(y, dy)
        return ((down @ self.coefficients) * across).sum(axis=1)

    def normals(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Unit normals (N, 3) towards the camera at points `x`, `y` (N,) m."""
        return geometry.normal_from_slope(self.evaluate(x, y, 1, 0), self.evaluate(x, y, 0, 1))

    def grid(self, dx: int = 0, dy: int = 0) -> Array:
        """z or its derivative of order (dx, dy) on the fitter's grid, (ny, nx)."""
        return self.fitter.grid_y[dy] @ self.coefficients @ self.fitter.grid_x[dx].T

    def height_sd(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Standard deviation (N,) m of z at points `x`, `y` (N,) m."""
        rows = self.fitter.rows(x, y)
        width = self.fitter.width
        half = solve_banded((width, 0), self.factor.T[: width + 1], rows.T)
        return np.sqrt(self.misfit * (half**2).sum(axis=0))

    def surface(self) -> Surface:
        """Heights on the grid, area and volume by Gauss quadrature, and their uncertainties to
        first order."""
        f = self.fitter
        (ny, nx), z, found = self.coefficients.shape, np.empty((len(f.y), len(f.x))), np.empty(4)
        kernel("measure_surface")(
            nx,
            ny,
            self.coefficients,
            self.factor,
            self.misfit,
            len(f.x),
            len(f.y),
            *f.tables,
            z,
            found,
        )
        area, volume, area_sd, volume_sd = found.tolist()
        if f.outside is not None:
            z[f.outside] = 0.0
        return Surface(f.x, f.y, z, area, volume, area_sd, volume_sd, self.status)


class SurfaceFitter:
    """Fits splines for one sensor; keeps the tables that do not depend on the frame of video.

    The settings' `roughness` 1/m^2 and `laplacian` 1/m are the g and k of the module's docstring.
    The spline has two or three more intervals than there are markers in a row, at least 8, and
    even: with a knot in the middle, where things are pressed, errors under a ball are half as
    large.
    """

    def __init__(self, design: SensorDesign, settings: SurfaceSettings = DEFAULTS.surface):
        self.settings = settings
        frame = design.frame
        layout = design.markers
        nx, ny = (max(8, n + 2 + n % 2) for n in (layout.columns, layout.rows))
        # half a pitch of a curvature k / 2
        slope_off = settings.laplacian / 4 * max(layout.pitch_x, layout.pitch_y)
        more = 0 if frame.outline is None else _MARGIN
        length, width = frame.length * (1 + more / nx), frame.width * (1 + more / ny)
        self.basis_x = Cubic(length, nx + more, _GAUSS)
        self.basis_y = Cubic(width, ny + more, _GAUSS)
        self.x, self.y = grid_of(frame)
        self.grid_x = [self.basis_x.at(self.x, d) for d in range(3)]
        self.grid_y = [self.basis_y.at(self.y, d) for d in range(3)]
        if frame.outline is None:  # exactly, not only to rounding
            self.grid_x[0][[0, -1]] = self.grid_y[0][[0, -1]] = 0.0
        quad_x, quad_y = (
            [a.at(a.points, d) for d in range(4)] for a in (self.basis_x, self.basis_y)
        )
        self._quad = quad_x, quad_y
        wx = self.basis_x.weights
        wy = self.basis_y.weights
        weights = wy[:, None] * wx * self._share_inside(frame)
        self.width = 3 * self.basis_x.count + 3
        beyond = None if frame.outline is None else wy[:, None] * wx - weights
        inside = None if beyond is None else weights
        stiffness = banded(self._energy(inside, ((1, 0),), ((0, 1),)), self.width)
        volume_c = quad_y[0].T @ weights @ quad_x[0]  # of the volume by the coefficients
        self.tables = (
            np.ascontiguousarray(self.grid_x[0].T),
            self.grid_y[0],
            len(wx),
            len(wy),
            np.stack([quad_x[0].T, quad_x[1].T]),
            np.stack(quad_y[:2]),
            weights,
            volume_c,
            stiffness,
        )
        bent = ((2, 0), (0, 2))
        self.prior = self._energy(inside, ((3, 0), (1, 2)), ((2, 1), (0, 3))) / (
            settings.roughness**2 * frame.area
        ) + self._energy(inside, bent) / (settings.laplacian**2 * frame.area)
        self.outside = None
        if frame.outline is not None:
            rim = self.rows(*frame.outline.points(_RIM_POINTS * 2 * max(nx, ny)).T)
            self.prior += rim.T @ rim / _RIM_SD**2
            self.prior += _BEYOND * self._energy(beyond, bent) / settings.laplacian**2 / frame.area
            places = np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)
            self.outside = (frame.inside(places) <= 0).reshape(len(self.y), len(self.x))
        self._prior_band = banded(self.prior, self.width)
        self._numbers = np.array(
            [
                length,
                width,
                design.camera.distance,
                settings.slope_model_sd,
                settings.slope_sd_most,
                slope_off,
                settings.outlier_sd,
                settings.outlier_least,
                settings.outliers_leave,
            ]
        )

    def fit(self, markers: Markers, *, normals: bool = True) -> Surface:
        """The surface through identified markers; see `fit_spline`."""
        return self.fit_spline(
            markers.p_SM, markers.cov_p, markers.n_S if normals else None
        ).surface()

    def fit_spline(
        self, p_SM: ArrayLike, cov_p: ArrayLike | None = None, n_S: ArrayLike | None = None
    ) -> Spline:
        """Fit markers at `p_SM` (N, 3) m with covariance `cov_p` (N, 3, 3) m^2 (default: 10 um) in
        S.

        With normals `n_S` (N, 3) of either sign their slopes count too, where they are known well
        enough (`slope_sd_of`, at the tilts of a first fit without them: the measured tilts would
        favour their own errors). A marker that is not finite, or far off the surface of the others,
        is left out.
        """
        p = np.asarray(p_SM, dtype=float).reshape(-1, 3)
        if cov_p is None:
            variance = np.full(len(p), 1e-10)
        else:
            variance = np.asarray(cov_p, dtype=float)[:, 2, 2]
        c = np.empty((self.basis_y.count, self.basis_x.count))
        factor = np.empty_like(self._prior_band)
        found = np.empty(2)
        # the prior is positive definite: only absurd weights make the normal equations not so
        kernel("fit_surface")(
            len(p),
            p,
            variance,
            n_S,
            self.basis_x.count,
            self.basis_y.count,
            self._numbers,
            self._prior_band,
            c,
            factor,
            found,
        )
        misfit, markers = found.tolist()
        return Spline(self, c, factor, misfit, _enough(int(markers), self.settings.markers_least))

    def rows(self, x: ArrayLike, y: ArrayLike, dx: int = 0, dy: int = 0) -> Array:
        """Design matrix (N, ny * nx): z or its derivative of order (dx, dy) at `x`, `y` (N,) m per
        coefficient."""
        return _products(self.basis_y.at(y, dy), self.basis_x.at(x, dx))

    def _share_inside(self, frame: Frame) -> Array:
        """Share (qy, qx) of what each Gauss point stands for that is in the opening."""
        x, y = self.basis_x, self.basis_y
        if frame.outline is None:
            return np.ones((len(y.points), len(x.points)))
        places = np.stack(np.meshgrid(x.points, y.points), axis=-1).reshape(-1, 2)
        across = np.sqrt(x.length / len(x.points) * y.length / len(y.points))
        share = np.clip(0.5 + frame.inside(places) / across, 0.0, 1.0)
        share = share.reshape(len(y.points), len(x.points))
        cut = share * (1 - share)
        lacking = frame.area - float(y.weights @ share @ x.weights)
        return share + cut * (lacking / float(y.weights @ cut @ x.weights))

    def _energy(self, weights: Array | None, *terms: tuple[tuple[int, int], ...]) -> Array:
        """Matrix of the integral of sum over `terms` of (d1 z + d2 z + ...)^2, each d an order of
        derivative (x, y), over Gauss points of `weights` (qy, qx) m^2; None: over the rectangle."""
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
                    total += np.kron(
                        gram(self._quad[1], wy, ay, by), gram(self._quad[0], wx, ax, bx)
                    )
        return total


def banded(matrix: Array, width: int) -> Array:
    """The lower triangle of a symmetric `matrix` (n, n) that vanishes beyond `width` from its
    diagonal, as kernels/band.h has it: (n, stride), row j column j from its diagonal on."""
    band = np.zeros((len(matrix), band_stride(width)))
    for below in range(min(width + 1, len(matrix))):
        band[: len(matrix) - below, below] = np.diagonal(matrix, -below)
    return band


def slope_sd(n: Array, p_CM: Array, variance: Array) -> Array:
    """Standard deviation (N,) of slopes measured at markers with unit normals `n` at `p_CM` (N, 3)
    m from the camera, whose depths have this `variance` (N,) m^2; see `slope_sd_of`."""
    far = np.sqrt(np.einsum("ni,ni->n", p_CM, p_CM))
    return slope_sd_of(n, p_CM / far[:, None], _ASPECT_PER_DEPTH * np.sqrt(variance) / far)


def slope_sd_of(n: ArrayLike, view: ArrayLike, aspect_sd: ArrayLike) -> Array:
    """Standard deviation (N,) of the slopes of markers with unit normals `n`, seen along unit rays
    `view` (N, 3).

    The tilt t against the line of sight comes from the ellipse's axis ratio cos(t), known to
    `aspect_sd` (N,): d t = aspect_sd / sin(t), and face-on at most sqrt(aspect_sd). Its direction
    comes from the ellipse's axes: with the same second harmonic's noise, sin(t) d(angle) =
    aspect_sd sin(t) / (2 (1 - cos(t))), to 5 % the same up to 35 degrees. A slope is tan of an
    angle to the axis: d tan = d t / n_z^2.
    """
    n = np.asarray(n, dtype=float)
    aspect_sd = np.asarray(aspect_sd, dtype=float)
    sine2 = 1 - np.einsum("ni,ni->n", n, np.asarray(view, dtype=float)) ** 2
    return (
        aspect_sd
        / np.sqrt(np.maximum(sine2, np.maximum(aspect_sd, 1e-12)))
        / np.maximum(n[:, 2] ** 2, 1e-6)
    )


def grid_of(frame: Frame, step: float = GRID_STEP) -> tuple[Array, Array]:
    """Grid lines x (nx,), y (ny,) m over the opening, frame included, at most `step` apart."""
    nx, ny = (int(np.ceil(size / step - 1e-9)) + 1 for size in (frame.length, frame.width))
    return np.linspace(-frame.length / 2, frame.length / 2, nx), np.linspace(
        -frame.width / 2, frame.width / 2, ny
    )


def reconstruct_delaunay(
    design: SensorDesign, p_SM: ArrayLike, *, grid_step: float = GRID_STEP
) -> Surface:
    """The paper's route: triangles, barycentric grid with the frame as boundary, B-spline surface.

    `p_SM` (N, 3) m. The "low resolution" grid that the spline goes through has half the markers'
    pitch. The paper gives no uncertainty: `area_sd`, `volume_sd` are NaN.
    """
    # lazily: only the paper's route needs it
    from scipy.interpolate import LinearNDInterpolator, RectBivariateSpline

    p_SM = np.asarray(p_SM, dtype=float).reshape(-1, 3)
    p_SM = p_SM[np.isfinite(p_SM).all(axis=1)]
    frame = design.frame
    layout = design.markers
    rim = _rim_points(frame, layout.columns + 1, layout.rows + 1)
    heights = LinearNDInterpolator(
        np.concatenate([p_SM[:, :2], rim]), np.append(p_SM[:, 2], np.zeros(len(rim)))
    )
    coarse_x = np.linspace(-frame.length / 2, frame.length / 2, 2 * layout.columns + 3)
    coarse_y = np.linspace(-frame.width / 2, frame.width / 2, 2 * layout.rows + 3)
    z = np.nan_to_num(heights(*np.meshgrid(coarse_x, coarse_y)))
    z[[0, -1]] = 0.0
    z[:, [0, -1]] = 0.0
    spline = RectBivariateSpline(coarse_y, coarse_x, z)
    (qx, wx), (qy, wy) = (
        (axis.points, axis.weights)
        for axis in (
            Cubic(frame.length, 2 * layout.columns + 2, _GAUSS),
            Cubic(frame.width, 2 * layout.rows + 2, _GAUSS),
        )
    )
    stretch = np.sqrt(1 + spline(qy, qx, dy=1) ** 2 + spline(qy, qx, dx=1) ** 2)
    area = float(wy @ stretch @ wx)
    volume = float(wy @ spline(qy, qx) @ wx)
    x, y = grid_of(frame, grid_step)
    return Surface(
        x,
        y,
        spline(y, x),
        area,
        volume,
        np.nan,
        np.nan,
        _enough(len(p_SM), DEFAULTS.surface.markers_least),
    )


def _enough(markers: int, least: int) -> Status:
    if markers >= least:
        return OK
    return Status(StatusCode.TOO_FEW_MARKERS, f"too few markers: {markers} of at least {least}")


def _rim_points(frame: Frame, nx: int, ny: int) -> Array:
    """Points (M, 2) all round the opening, nx and ny to a side."""
    t = np.linspace(-1, 1, nx, endpoint=False)[:, None]
    s = np.linspace(-1, 1, ny, endpoint=False)[:, None]
    one_t = np.ones_like(t)
    one_s = np.ones_like(s)
    square = np.concatenate(
        [
            np.hstack([t, -one_t]),
            np.hstack([one_s, s]),
            np.hstack([-t, one_t]),
            np.hstack([-one_s, -s]),
        ]
    )
    return square * [frame.length / 2, frame.width / 2]


def _products(down: Array, across: Array) -> Array:
    """Row-wise Kronecker product (N, ny * nx) of (N, ny) and (N, nx)."""
    return (down[:, :, None] * across[:, None, :]).reshape(
        len(down), down.shape[1] * across.shape[1]
    )
