"""Reference in numpy for the kernel of mjtactile/kernels/ellipse_profiles.c: the same estimator.

K profiles cross each ellipse along its normals. One `cv2.remap` reads them all. One matrix product
reduces each to a few numbers (levels, area, offset of the edge by a matched filter, width), and one
batched 5 x 5 solve moves the ellipses. Offsets first come from the area (right even two pixels
away), then from the matched filter (near the Cramer-Rao bound close to the edge).

A disc blurred by a Gaussian of standard deviation sigma has its 50 % level further in by kappa
sigma^2/2 (kappa: curvature of the edge). Sigma is measured from the profiles, and the bias is
removed. This holds to first order in kappa sigma; `edges` is for the small markers where that is
not enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from mjtactile.core.types import Array
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.image.edge_fit import SOFTEN, SOFTEN_VARIANCE, EdgeFit
from mjtactile.sensing.image.ellipse import upper_median
from mjtactile.sensing.settings import DEFAULTS, ProfileSettings
from tests.numpy_pipeline.ellipse import covariance_of_moves

# along a profile; of these, at either end, for the levels
_SAMPLES = 17
_ENDS = 5
# of [o < 0]: the sum of the offsets, in samples, on the inside
_STEP_MOMENT = -(_SAMPLES**2 - 1) / 8
# px between samples, profiles per marker of the first rounds
_COARSE_STEP = 0.9
_COARSE_COUNT = 24
_COARSE_ROUNDS = 4
_NEAR = 1.5  # px: a coarse move below this ends the coarse rounds; it is right by area within two
# Softening before bilinear interpolation makes the image smooth enough for it. Without it, offsets
# depend on the position of the edge within a pixel, by 2 um of depth in the paper's geometry.
_BILINEAR_VARIANCE = 1 / 6  # of linear interpolation, mean over all positions
_NEIGHBOURS = -(np.arange(1.0, 5.0)[:, None] ** 2)
_LEVEL_MOVES = np.diag([2.0, 2.0, 1.0, 0.0, 1.0])
_LEVEL_MOVES[2, 4] = _LEVEL_MOVES[4, 2] = 1.0
INSIDE, OUTSIDE, AREA, SECOND, EDGE, BLUR = range(6)


@dataclass(frozen=True)
class _Fan:
    """K directions on the unit circle, and all quantities that depend only on them.

    Points `e` (2, K). Functions (5, K) e, e e^T that move an ellipse, their products `pairs` (K,
    25), and their pseudo-inverse `solve` (K, 5). `plane` (K, 3) maps values to their mean and
    gradient, `one` (3, K) maps these to values; `mean` (K,) gives the mean.
    """

    e: NDArray
    basis: NDArray
    pairs: NDArray
    solve: NDArray
    plane: NDArray
    one: NDArray
    mean: NDArray

    @property
    def count(self) -> int:
        return self.e.shape[1]


@lru_cache(maxsize=32)
def _fan(count: int) -> _Fan:
    t = 2 * np.pi * np.arange(count) / count
    c = np.cos(t)
    s = np.sin(t)
    one = np.ones(count)
    basis = np.stack([c, s, c * c, 2 * c * s, s * s])
    pairs = (basis[:, None] * basis).reshape(25, count).T
    plane = np.stack([one, 2 * c, 2 * s], axis=1) / count
    arrays = (
        np.stack([c, s]),
        basis,
        pairs,
        np.linalg.pinv(basis),
        plane,
        np.stack([one, c, s]),
        one / count,
    )
    return _Fan(*(np.ascontiguousarray(array, dtype=np.float64) for array in arrays))


@dataclass(frozen=True)
class _Outline:
    """N ellipses at the fan's K parameters.

    Outward normals `m` (2, N, K), m = S^-1 e/g. `arc` per profile (N, K) px, the arc length det(S)
    g dt. g = |S^-1 e| (N, K) 1/px. The curvature is 1/(det(S)^2 g^3).
    """

    m: NDArray
    arc: NDArray
    g: NDArray
    det: NDArray  # determinant of S (N, 1), px^2


def fit(
    image: NDArray, center: Array, shape: Array, s: ProfileSettings = DEFAULTS.profiles
) -> EdgeFit:
    """Fit N ellipses starting from `center` (N, 2), `shape` (N, 3) px, right to about two
    pixels."""
    source = cv2.sepFilter2D(image, cv2.CV_32F, SOFTEN, SOFTEN, borderType=cv2.BORDER_REPLICATE)
    center, shape, sigma = _approach(source, center, shape, s)
    step = s.step * max(1.0, sigma / s.start_blur)
    fan = _fan(int(np.clip(8 * np.ceil(upper_median(_perimeter(shape)) / s.spacing / 8), 32, 160)))
    line = _outline(shape, fan)
    numbers = _read(source, center, shape, line, fan, step, sigma)
    inside, outside, spread = _levels(numbers, fan, s.level_outlier)
    over = 1 / (inside - outside)
    _, rest, sums = _filters(step, sigma)
    delta = (numbers[EDGE] - sums[EDGE] * outside) * over - rest[0]
    blur = (numbers[BLUR] - sums[BLUR] * outside) * over + (sigma - rest[1])
    blur = np.maximum(blur, 0.5)
    delta *= 1 / _gain(step, sigma, upper_median(blur[:, ::4]))
    blur, retreat, motion = _retreat(blur, line, s.max_blur_variance)
    delta = np.minimum(np.maximum(delta, -2), 2) + retreat
    center, shape, inverse, weight, left = _settle(center, shape, delta, line, fan, s)
    # how the levels' noise moves an offset: d(delta)/d(inside), d(delta)/d(outside), in px per unit
    # of contrast
    gain = np.array([rest[0], sums[EDGE] - rest[0]])
    common = (gain[:, None] ** 2 * spread**2).sum(axis=0) * ((over * over) @ fan.mean)
    levels = inside @ fan.mean, outside @ fan.mean
    return _result(center, shape, inverse, weight, left, line, levels, common, motion, blur, s)


def _approach(
    source: NDArray, center: Array, shape: Array, s: ProfileSettings
) -> tuple[Array, Array, float]:
    """Return ellipses near the edge by area, and the image's blur; the window grows until it
    contains the blurred edge."""
    fan = _fan(_COARSE_COUNT)
    step = _COARSE_STEP
    sigma = s.start_blur
    for _ in range(_COARSE_ROUNDS):
        line = _outline(shape, fan)
        numbers = _read(source, center, shape, line, fan, step, s.start_blur)
        inside, outside, _ = _levels(numbers, fan, s.level_outlier)
        over = 1 / (inside - outside)
        delta = (numbers[AREA] - _SAMPLES * outside) * over - 0.5 * _SAMPLES
        old = shape
        moved = np.minimum(np.maximum(delta * step, -3), 3)
        center, shape = ellipse.moved(center, shape, (moved * line.g) @ fan.solve)
        sigma = _common_blur(numbers, over, delta, step, fan)
        wide = sigma > 0.27 * step * _SAMPLES / 2
        if np.abs(shape - old).max() < _NEAR and not wide:
            break
        step *= 1.6 if wide and step < 3 else 1.0
    return center, shape, sigma


def _retreat(blur: NDArray, line: _Outline, maximum: float) -> tuple[Array, NDArray, NDArray]:
    """Return each marker's blur (N,), the inward shift (N, K) of its 50 % level, and the part of
    the blur (N,) that motion adds, all px.

    Blur along the curved edge causes the shift: kappa/2 times the blur's variance along the edge's
    tangent. `blur` (N, K) is the standard deviation across the edge. Motion blurs one direction
    more: the variance across an edge with normal m is m^T B m. One tensor B holds for the image
    (least squares); the remainder per marker is defocus.
    """
    some = blur[:, ::4]  # enough for three numbers
    variance = some * some
    bound = np.minimum(variance, maximum * upper_median(variance))
    mx, my = line.m
    mxx = mx * mx
    mxy = 2 * mx * my
    myy = my * my
    A = np.array([mxx[:, ::4], mxy[:, ::4], myy[:, ::4]])
    flat = A.reshape(3, -1)
    b = np.linalg.solve(
        (flat @ flat.T).astype(float) + 1e-9 * np.eye(3), (flat @ bound.ravel()).astype(float)
    )
    uu, uv, vv = b
    mean = bound.mean(axis=1)
    own = mean - A.mean(axis=2).T @ b
    along = np.maximum(uu * myy - uv * mxy + vv * mxx + own[:, None], 0.3)
    half_curvature = 0.5 / (line.det * line.det * (line.g * line.g * line.g))
    motion = np.hypot((uu - vv) / 2, uv) * half_curvature.max(axis=1)
    return np.sqrt(np.maximum(mean, 0.3)), along * half_curvature, motion


def _perimeter(shape: Array) -> Array:
    """Return perimeters (N,) px of the ellipses, to a percent."""
    return 2 * np.pi * np.sqrt((shape[:, 0] ** 2 + shape[:, 2] ** 2) / 2 + shape[:, 1] ** 2)


def _common_blur(numbers: NDArray, over: NDArray, delta: NDArray, step: float, fan: _Fan) -> float:
    """Blur sd (px) common to the image, from the second moment of the profiles' deviation from a
    step.

    For F = Phi(-(o - d)/sigma): integral of (F - [o < 0]) o do = (sigma^2 + d^2)/2. `over` is
    1/contrast.
    """
    # the weights' own sum is zero: the outside level drops out
    second = numbers[SECOND] * over - _STEP_MOMENT
    # 1/6: reduction of the second moment of a smooth step by sampling, in samples squared
    squared = (upper_median((2 * second - delta * delta) @ fan.mean) + 1 / 6) * step * step
    return min(max(squared, 0.75**2), 4.0**2) ** 0.5


def _offsets(step: float) -> Array:
    return (np.arange(_SAMPLES) - (_SAMPLES - 1) / 2) * step


@lru_cache(maxsize=64)
def _filter_bank(step: float, sigma: float) -> tuple[NDArray, Array, Array]:
    o = _offsets(step)
    z = o / sigma
    phi = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) / sigma
    # matched to the pixels: half of the blur by softening and interpolation is already in the
    # samples' noise
    narrow = np.sqrt(max(sigma**2 - 2 * (SOFTEN_VARIANCE + _BILINEAR_VARIANCE), 0.45**2))
    edge = np.exp(-0.5 * (o / narrow) ** 2)
    pair = np.stack([edge / (edge @ phi), (phi * z) / ((phi * z) @ (phi * z))])
    bank = np.zeros((_SAMPLES, 6))
    bank[:_ENDS, INSIDE] = bank[-_ENDS:, OUTSIDE] = 1 / _ENDS
    bank[:, AREA] = 1.0
    bank[:, SECOND] = _offsets(1.0)
    bank[:, EDGE], bank[:, BLUR] = pair
    return bank, (pair @ ndtr(-z)), bank.sum(axis=0)


def _filters(step: float, sigma: float) -> tuple[NDArray, Array, Array]:
    """Return the filter columns (J, 6), the EDGE and BLUR readings of a unit step of standard
    deviation `sigma` at 0, and the columns' sums.

    EDGE and BLUR read delta and dsigma in F(o) + delta phi + dsigma psi, with F = Phi(-o/sigma),
    phi = -dF/do, psi = dF/dsigma. One is even and the other odd, so that each ignores the other.
    """
    return _filter_bank(step, sigma)


def _gain(step: float, sigma: float, blur: float) -> float:
    """Return the EDGE reading of the filters for `sigma` per px of edge offset, for small offsets
    and an actual blur of `blur`."""
    z = _offsets(step) / blur
    return float(_filters(step, sigma)[0][:, EDGE] @ np.exp(-0.5 * z * z)) / (
        np.sqrt(2 * np.pi) * blur
    )


def _outline(shape: Array, fan: _Fan) -> _Outline:
    p, q, s = shape.T
    det = p * s - q * q
    m = (np.array([[s, -q], [-q, p]]) / det).transpose(0, 2, 1) @ fan.e
    g = np.sqrt(m[0] * m[0] + m[1] * m[1])
    m /= g
    det = det[:, None]
    return _Outline(m, g * (2 * np.pi / fan.count * det), g, det)


def _read(
    source: NDArray,
    center: Array,
    shape: Array,
    line: _Outline,
    fan: _Fan,
    step: float,
    sigma: float,
) -> NDArray:
    """Apply the filters to the profiles across the ellipses, outwards: (6, N, K)."""
    offsets = _offsets(step)
    (u, v), (p, q, s) = center.T, shape.T
    place = np.array([[u, p, q], [v, q, s]], np.float64).transpose(0, 2, 1) @ fan.one
    rays = np.array([[place[0], line.m[0]], [place[1], line.m[1]]]).reshape(2, 2, -1)
    maps = np.array([np.ones(_SAMPLES), offsets], np.float64).T @ rays
    # not cv2.remap, which rounds places to 1/32 px
    values = map_coordinates(source.astype(float), maps[::-1], order=1, mode="nearest")
    return (_filters(step, sigma)[0].T @ values).reshape(-1, *line.g.shape)


def _levels(numbers: NDArray, fan: _Fan, outlier: float) -> tuple[NDArray, NDArray, NDArray]:
    """Return levels (N, K) inside and outside of each profile: per marker, plus a gradient of the
    light across it.

    Also the sd (2, N) of a single profile's level about them.
    """
    ends = numbers[[INSIDE, OUTSIDE]]
    middle = (ends @ fan.mean)[..., None]
    spread = ends - middle
    bound = outlier * np.sqrt((spread * spread) @ fan.mean)[..., None] + 1e-3
    spread = np.minimum(np.maximum(spread, -bound), bound)
    plane = spread @ fan.plane
    plane[..., :1] += middle
    inside, outside = fitted = plane @ fan.one
    spread -= fitted - middle
    low = np.abs(inside - outside) < 1.0  # no contrast, no edge; the caller throws such fits away
    if low.any():
        inside = np.where(low, outside - 1.0, inside)
    return inside, outside, np.sqrt((spread * spread) @ fan.mean)


def _settle(
    center: Array, shape: Array, delta: NDArray, line: _Outline, fan: _Fan, s: ProfileSettings
) -> tuple[Array, Array, Array, NDArray, NDArray]:
    """Move ellipses by robust least squares to the edge offsets `delta` (N, K) px along the
    normals.

    An offset moves e on the unit circle by delta g = e . w + e^T V e, with w = S^-1 dc and V =
    sym(S^-1 dS). One basis serves all ellipses, so that all normal matrices are one product. Also
    returns the inverse normal matrices (N, 5, 5) of (w, V), the weights (N, K), and the residual of
    `delta`.
    """
    over = 1 / line.g
    scaled = delta * line.g
    # unweighted: only to detect outliers
    left = delta - ((scaled @ fan.solve) @ fan.basis) * over
    t = (
        left
        * (1 / np.maximum(s.outlier_offsets * (np.abs(left) @ fan.mean), s.outlier_min))[:, None]
    )
    t *= t
    t *= t
    t += 1
    weight = line.arc / t
    w = weight * over * over
    inverse = np.linalg.inv((w @ fan.pairs).reshape(-1, 5, 5).astype(float))
    move = (inverse @ ((w * scaled) @ fan.basis.T)[..., None])[..., 0]
    left = delta - (move @ fan.basis) * over
    return *ellipse.moved(center, shape, move), inverse, weight, left


def _result(
    center: Array,
    shape: Array,
    inverse: Array,
    weight: NDArray,
    left: NDArray,
    line: _Outline,
    levels: tuple[NDArray, NDArray],
    common: Array,
    motion: NDArray,
    blur: NDArray,
    s: ProfileSettings,
) -> EdgeFit:
    inside, outside = levels
    count = line.g.shape[1]
    total = weight.sum(axis=1)
    spread = (weight * left * left).sum(axis=1)
    spacing = line.arc.mean(axis=1).astype(float)
    size = line.g.mean(axis=1).astype(float)
    variance = spread / total * (count / (count - 5))
    # Profiles share some pixels. Neighbours at distance d correlate as the autocorrelation of
    # softening and interpolation together, nearly a Gaussian. The factor is the sum over all
    # neighbours.
    total_variance = 4 * (SOFTEN_VARIANCE + _BILINEAR_VARIANCE)
    shared = 1 + 2 * np.exp(spacing**2 * _NEIGHBOURS / total_variance).sum(axis=0)
    variance *= (count - 5) / np.maximum(count - 5 * shared, 1)
    cov = inverse * (s.covariance_factor * variance * shared * spacing)[:, None, None]
    # An error of the levels moves all offsets together, V = I g, and one of their gradient moves
    # the centre, w = g.
    level = common * shared / count * size**2
    cov += level[:, None, None] * _LEVEL_MOVES
    cov[:, [2, 3, 4], [2, 3, 4]] += ((s.motion_sd_fraction * motion * size) ** 2)[:, None]
    # an offset's rms in px, as grey levels at the edge's slope, to compare with the contrast
    residual = np.sqrt(variance) * np.abs(inside - outside) / (np.sqrt(2 * np.pi) * blur)
    lost = 1 - total / (spacing * count)
    optical = np.sqrt(np.maximum(blur * blur - SOFTEN_VARIANCE - _BILINEAR_VARIANCE, s.sharpest**2))
    return EdgeFit(
        center,
        shape,
        covariance_of_moves(cov, shape),
        inside,
        outside,
        optical,
        residual,
        np.full(len(center), float(count)),
        lost,
        motion,
    )
