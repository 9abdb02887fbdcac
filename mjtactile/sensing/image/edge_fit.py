"""Sub-pixel ellipses by least squares on the image, for all markers together.

Estimator for small or strongly blurred markers. `profiles` is ten times faster for larger ones.
Model of the pixels near one marker's edge, (dx, dy) from its center:

    I = (1 + g . (dx, dy)) (outside + (inside - outside) F)

F is the filled ellipse blurred by a Gaussian of standard deviation sigma. Sigma combines lens,
pixel and the softening below. For large markers F = Phi(-(n + kappa sigma^2/2)/sigma). Here n is
the outward distance and kappa the edge curvature. The blurred curved edge has its 50 % level
further inward. In the paper's geometry this changes the depth by 41 um. For small markers F is
integrated. Ten parameters per marker: center, shape, inside, outside, gradient g of the light,
sigma. The solver is Gauss-Newton with robust weights. The arithmetic is in
mjtactile/kernels/edge_fits.c.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.image.edge_bands import NeighborMarkers, Pixels, band
from mjtactile.sensing.settings import DEFAULTS, EdgeSettings

PARAMETERS = 10
# Light softening first: it reduces the effect of processing of single pixels in the camera
# (sharpening, demosaicing, compression).
SOFTEN = np.array([0.2, 0.6, 0.2])
SOFTEN_VARIANCE = 0.4  # px^2 per axis
_PIXELS_AT_ONCE = 30_000  # a working set that stays in the processor's cache
_PIXELS_FIRST = 170  # pixels per marker for the first steps and for the normal matrix
_CONVERGED = 0.005  # px: the largest step after which all pixels are used
_SETTLED = 0.05  # px: the largest last step of a fit that has converged
UNSETTLED = 1e3  # gray levels added to the residual of unconverged fits, so that they are rejected


@dataclass(frozen=True)
class EdgeFit:
    """N fits: `center` (N, 2), `shape` (N, 3), px, and `cov` (N, 5, 5) of (u, v, p, q, s). `inside`
    and `outside` are levels (N,), and `blur` (N,) is in px. `residual` (N,) is the rms in gray
    levels. `pixels` (N,) is the number of pixels used, and `lost` (N,) the lost fraction of robust
    weight. `motion` (N,), px, is the part of the blur correction due to motion."""

    center: Array
    shape: Array
    cov: Array
    inside: Array
    outside: Array
    blur: Array
    residual: Array
    pixels: Array
    lost: Array
    motion: Array

    def take(self, keep: NDArray[np.bool_]) -> EdgeFit:
        """Return the fits selected by `keep` (N,)."""
        return EdgeFit(*(column[keep] for column in vars(self).values()))


@dataclass(frozen=True)
class _KnownBlur:
    """Blur of `sigma` px (softening included). `weight` is that of a prior for it, over the pixels'
    noise variance."""

    sigma: float
    weight: float


def fit(
    image: NDArray,
    center: Array,
    shape: Array,
    *,
    blur: float = 0.8,
    blur_sd: float = np.inf,
    iterations: int = 4,
    others: tuple[Array, Array] | None = None,
    s: EdgeSettings = DEFAULTS.edges,
) -> EdgeFit:
    """Fit N ellipses starting from `center` (N, 2), `shape` (N, 3), and `blur` px. The blur is
    approximate. `blur_sd`, px, is its standard deviation from another source. Pixels that another
    marker darkens are left out. `others` holds centers and shapes of more such markers."""
    width = max(5.0, 3.5 * blur)
    known = _KnownBlur(
        float(np.hypot(blur, np.sqrt(SOFTEN_VARIANCE))), s.covariance_factor / blur_sd**2
    )
    image = cv2.sepFilter2D(image, cv2.CV_32F, SOFTEN, SOFTEN, borderType=cv2.BORDER_REPLICATE)
    if others is not None:
        others = np.concatenate([center, others[0]]), np.concatenate([shape, others[1]])
    around = NeighborMarkers.of(*(others or (center, shape)), len(center), width, s)
    parts = []
    first = 0
    perimeter = 2 * np.pi * np.sqrt((shape[:, 0] ** 2 + shape[:, 2] ** 2) / 2 + shape[:, 1] ** 2)
    load = np.cumsum(perimeter * 2 * width)
    while first < len(center):
        done = load[first - 1] if first else 0.0
        last = max(first + 1, int(np.searchsorted(load, done + _PIXELS_AT_ONCE)))
        parts.append(
            _fit_some(
                image,
                center[first:last],
                shape[first:last],
                around.part(first, last),
                width,
                known,
                iterations,
                s,
            )
        )
        first = last
    if not parts:
        none = np.zeros(0)
        return EdgeFit(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 5, 5)), *[none] * 7)
    return EdgeFit(
        *(np.concatenate(column) for column in zip(*(vars(p).values() for p in parts), strict=True))
    )


def merge(first: NDArray[np.bool_], fit: EdgeFit, other: EdgeFit) -> EdgeFit:
    """Return the fits of `fit` where `first` is True, else those of `other`."""
    columns = []
    for a, b in zip(vars(fit).values(), vars(other).values(), strict=True):
        both = np.empty((len(first), *a.shape[1:]))
        both[first] = a
        both[~first] = b
        columns.append(both)
    return EdgeFit(*columns)


def _levels(image: NDArray, center: Array, shape: Array) -> tuple[Array, Array]:
    """Estimate initial levels inside and outside as medians on two rings: at half the size, and 4
    px outside."""
    height, width = image.shape
    rings = []
    for ring in (0.5 * shape, shape + [4.0, 0.0, 4.0]):
        points = np.rint(ellipse.boundary(center, ring, 8)[0]).astype(np.int64)
        u = np.clip(points[..., 0], 0, width - 1)
        v = np.clip(points[..., 1], 0, height - 1)
        rings.append(np.median(image[v, u].astype(float), axis=1))
    return rings[0], rings[1]


def _fit_some(
    image: NDArray,
    center: Array,
    shape: Array,
    around: NeighborMarkers,
    width: float,
    blur: _KnownBlur,
    iterations: int,
    s: EdgeSettings,
) -> EdgeFit:
    """Fit markers of similar size by Gauss-Newton. The first steps use a subset of the pixels. The
    last two use all."""
    small = bool(
        (shape[:, 0] * shape[:, 2] - shape[:, 1] ** 2).min()
        < (s.small_radius * max(blur.sigma, 1)) ** 2
    )
    iterations += 8 if small else 0  # blur, radius and level are harder to separate
    pixels, used, origin = gather(image, center, shape, around, width)
    theta = np.zeros((len(center), PARAMETERS))
    theta[:, :2] = center - origin
    theta[:, 2:5] = shape
    theta[:, 5], theta[:, 6] = _levels(image, center, shape)
    theta[:, 9] = blur.sigma
    H, sums = fit_pixels(pixels, theta, blur, iterations - 2, small, s)
    wrong = (sums[:, 3] > _SETTLED) | (theta[:, 9] < s.sharpest)
    kept, plain, square, _ = sums.T
    square = square + wrong * (2 * UNSETTLED * plain + UNSETTLED**2 * kept)
    return _result(theta, H, kept, square, used, origin, s.covariance_factor)


def fit_pixels(
    pixels: Pixels, theta: Array, blur: _KnownBlur, steps: int, small: bool, s: EdgeSettings
) -> tuple[Array, Array]:
    """Fit the parameters `theta` (n, 10) of n markers to their pixels, in place, by up to `steps`
    steps with a subset of the pixels, and two with all.

    Returns:
        Normal matrices (n, 10, 10). Sums (n, 4) of weight, weighted residual and weighted squared
        residual; last change of center and shape, px.
    """
    n = len(theta)
    stride = max(1, int(pixels.counts.mean()) // _PIXELS_FIRST)
    outliers = (s.outlier_residuals, s.outlier_fraction)
    settings = np.array([small, stride, steps, blur.sigma, blur.weight, _CONVERGED, *outliers])
    H = np.empty((n, PARAMETERS, PARAMETERS))
    sums = np.empty((n, 4))
    observed = (len(pixels.x), pixels.counts, pixels.x, pixels.y, pixels.observed)
    kernel("fit_edges")(n, *observed, settings, theta, H, sums)
    return H, sums


def gather(
    image: NDArray, center: Array, shape: Array, around: NeighborMarkers, width: float
) -> tuple[Pixels, NDArray, Array]:
    """Return the band pixels without those darkened by neighbors. Also return their true count per
    marker, and each marker's origin (whole px)."""
    u, v, used = band((image.shape[0], image.shape[1]), center, shape, width)
    if around.near.size:
        clear = around.clear(u, v, used)
        owner = np.repeat(np.arange(len(used)), used)
        u = u[clear]
        v = v[clear]
        used = np.bincount(owner[clear], minlength=len(used))
    counts = used
    # marker completely outside the image: one placeholder pixel, so that no segment is empty
    if (used == 0).any():
        at = np.cumsum(used)[used == 0]
        u = np.insert(u, at, 0)
        v = np.insert(v, at, 0)
        counts = np.maximum(used, 1)
    origin = np.rint(center)
    x = u - np.repeat(origin[:, 0], counts)
    y = v - np.repeat(origin[:, 1], counts)
    observed = image.ravel()[v * image.shape[1] + u]
    return (
        Pixels(x.astype(np.float32), y.astype(np.float32), observed.astype(np.float32), counts),
        used,
        origin,
    )


def _result(
    theta: Array,
    H: Array,
    kept: Array,
    square: Array,
    used: NDArray,
    origin: Array,
    coloured: float,
) -> EdgeFit:
    diagonal = np.arange(PARAMETERS)
    H[:, diagonal, diagonal] = H[:, diagonal, diagonal] * (1 + 1e-9) + 1e-9
    variance = square / np.maximum(kept - PARAMETERS, 1)
    cov = np.linalg.inv(H)[:, :5, :5] * (coloured * variance)[:, None, None]
    cov = (cov + cov.transpose(0, 2, 1)) / 2
    lost = 1 - kept / np.maximum(used, 1)
    optical = np.sqrt(np.maximum(theta[:, 9] ** 2 - SOFTEN_VARIANCE, 0.09))
    return EdgeFit(
        theta[:, :2] + origin,
        theta[:, 2:5],
        cov,
        theta[:, 5],
        theta[:, 6],
        optical,
        np.sqrt(variance),
        used.astype(float),
        lost,
        np.zeros(len(theta)),
    )
