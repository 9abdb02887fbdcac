"""Sub-pixel ellipses from edge profiles, for all markers in one go: what runs at camera rate.

K profiles cross each ellipse along its normals; one `cv2.remap` reads them all, one matrix product turns each into a
few numbers (levels, area, offset of the edge by a matched filter, width), and one batched 5 x 5 solve moves the
ellipses. Offsets are first found by area (right even two pixels away), then by the matched filter (near the
Cramer-Rao bound close to the edge).

A disc blurred by a Gaussian of sd sigma has its 50 % level further in by kappa sigma^2/2 (kappa: curvature of the
edge); sigma is measured from the profiles themselves and the bias removed. To first order in kappa sigma: `edges` is
for the small markers where that is not enough.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from mjtactile.sensing import ellipse
from mjtactile.sensing.edges import SOFTEN, SOFTEN_VARIANCE, EdgeFit
from mjtactile.types import Array

_SAMPLES, _ENDS = 17, 5  # along a profile; of these, at either end, for the levels
_COARSE_STEP, _COARSE_COUNT = 0.9, 24  # px between samples, profiles per marker of the first rounds
_STEP = 0.75  # px between samples of the last round, for blur up to _SIGMA; more blur stretches it
_SIGMA = 1.1  # px
_COARSE_ROUNDS = 4
_NEAR = 1.0  # px: a coarse move below this ends the coarse rounds
_PER_PIXEL = 2.0  # px of arc between the profiles of the last round
# Softening before bilinear interpolation makes the image smooth enough for it: without, offsets depend on where the
# edge lies within a pixel, by 2 um of depth in the paper's geometry.
_BILINEAR_VARIANCE = 1 / 6  # of linear interpolation, mean over all positions
# Rounding, interpolation and the blur's own noise, as a share of the variance, by Monte Carlo.
_UNMODELLED = 1.08
_MOTION_DOUBT = 0.5  # motion is no Gaussian: the share of its correction that is in doubt
_LEVEL_MOVES = np.diag([2.0, 2.0, 1.0, 0.0, 1.0])
_LEVEL_MOVES[2, 4] = _LEVEL_MOVES[4, 2] = 1.0
INSIDE, OUTSIDE, AREA, SECOND, EDGE, BLUR = range(6)


def fit(image: NDArray, center: Array, shape: Array) -> EdgeFit:
    """Fit N ellipses starting from `center` (N, 2), `shape` (N, 3) px, right to about two pixels."""
    source = cv2.sepFilter2D(image, cv2.CV_32F, SOFTEN, SOFTEN, borderType=cv2.BORDER_REPLICATE)
    center, shape, sigma = _approach(source, center, shape)
    step = _STEP * max(1.0, sigma / _SIGMA)
    count = int(np.clip(8 * np.ceil(np.median(_perimeter(shape)) / _PER_PIXEL / 8), 32, 160))
    e = _directions(count)
    m, arc, g = _frame(shape, e)
    numbers = _read(source, center, shape, e, m, step, sigma)
    inside, outside, spread = _levels(numbers, e)
    contrast = inside - outside
    _, rest, sums = _filters(step, sigma)
    delta = (numbers[EDGE] - outside * sums[EDGE]) / contrast - rest[0]
    widen = (numbers[BLUR] - outside * sums[BLUR]) / contrast - rest[1]
    blur, retreat, motion = _retreat(np.maximum(sigma + widen, 0.5), m, arc, g)
    center, shape, inverse, weight, left = _move(center, shape, np.clip(delta, -2, 2) + retreat, e, arc, g, robust=True)
    # how the levels' noise moves an offset: d(delta)/d(inside), d(delta)/d(outside), in px per unit of contrast
    gain = np.array([rest[0], sums[EDGE] - rest[0]])
    common = (gain[:, None] ** 2 * spread**2).sum(axis=0) / (contrast * contrast).mean(axis=1)
    return _result(center, shape, inverse, weight, left, arc, np.stack([inside, outside]), g, common, motion, blur)


def _approach(source: NDArray, center: Array, shape: Array) -> tuple[Array, Array, float]:
    """Ellipses near the edge by area, and the image's blur; the window grows until it holds the blurred edge."""
    e = _directions(_COARSE_COUNT)
    step, sigma = _COARSE_STEP, _SIGMA
    for _ in range(_COARSE_ROUNDS):
        m, arc, g = _frame(shape, e)
        numbers = _read(source, center, shape, e, m, step, _SIGMA)
        inside, outside, _ = _levels(numbers, e)
        delta = (numbers[AREA] - outside * _SAMPLES) / (inside - outside) - 0.5 * _SAMPLES
        old = shape
        center, shape, *_ = _move(center, shape, np.clip(delta * step, -3, 3), e, arc, g)
        sigma = _common_blur(numbers, inside, outside, delta, step)
        wide = sigma > 0.27 * step * _SAMPLES / 2
        if np.abs(shape - old).max() < _NEAR and not wide:
            break
        step *= 1.6 if wide and step < 3 else 1.0
    return center, shape, sigma


def _retreat(blur: Array, m: tuple[Array, Array], arc: Array, g: Array) -> tuple[Array, Array, Array]:
    """Each marker's blur sd (N,) px, how far (N, K) px the blur along the curved edge moves its 50 % level inwards:
    kappa/2 times the blur's variance along the edge's tangent, and the part of it (N,) px that motion adds.

    `blur` (N, K) is the sd across the edge. Motion blurs one direction more: the variance across an edge with normal
    m is m^T B m, with one tensor B for the image (least squares), and what is left over per marker (defocus).
    """
    variance = blur * blur
    some = variance[:, ::4]  # enough for three numbers
    bound = np.clip(some, 0.0, 3 * np.median(some))
    mx, my = m
    A = np.stack([(mx * mx)[:, ::4].ravel(), (2 * mx * my)[:, ::4].ravel(), (my * my)[:, ::4].ravel()], axis=1).astype(float)
    b = np.linalg.solve(A.T @ A + 1e-9 * np.eye(3), A.T @ bound.ravel())
    own = (bound - (A @ b).reshape(bound.shape)).mean(axis=1, keepdims=True)
    uu, uv, vv = b.astype(np.float32)
    along = np.maximum(uu * (my * my) - 2 * uv * (mx * my) + vv * (mx * mx) + own.astype(np.float32), np.float32(0.3))
    det = arc[:, :1] * arc.shape[1] / (2 * np.pi * g[:, :1])  # of S
    half_curvature = (0.5 / (det * det)).astype(np.float32) / (g * g * g)
    motion = np.hypot((uu - vv) / 2, uv) * half_curvature.max(axis=1)
    return np.sqrt(np.maximum(bound.mean(axis=1), 0.3)), along * half_curvature, motion


def _perimeter(shape: Array) -> Array:
    """Perimeters (N,) px of the ellipses, to a percent."""
    return 2 * np.pi * np.sqrt((shape[:, 0] ** 2 + shape[:, 2] ** 2) / 2 + shape[:, 1] ** 2)


def _directions(count: int) -> Array:
    """Unit-circle parameters e (2, count) of the profiles."""
    t = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(t), np.sin(t)]).astype(np.float32)


def _common_blur(numbers: Array, inside: Array, outside: Array, delta: Array, step: float) -> float:
    """Blur sd (px) common to the image, from the second moment of the profiles' deviation from a step.

    For F = Phi(-(o - d)/sigma): integral of (F - [o < 0]) o do = (sigma^2 + d^2)/2.
    """
    weights = _offsets(1.0)
    base = weights[weights < 0].sum()
    second = (numbers[SECOND] - outside * weights.sum()) / (inside - outside) - base
    # 1/6: what sampling takes off the second moment of a smooth step, in samples squared
    squared = (2 * second - delta * delta + 1 / 6) * step * step
    return float(np.sqrt(np.clip(np.median(squared.mean(axis=1)), 0.75**2, 4.0**2)))


def _offsets(step: float) -> Array:
    return (np.arange(_SAMPLES) - (_SAMPLES - 1) / 2) * step


@lru_cache(maxsize=64)
def _filter_bank(step_k: int, sigma_k: int) -> tuple[NDArray, Array, Array]:
    step, sigma = step_k / 100, sigma_k / 100
    o = _offsets(step)
    z = o / sigma
    phi = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) / sigma
    # matched to what the pixels hold: half of the softening's and interpolation's blur is in the samples' noise already
    narrow = np.sqrt(max(sigma**2 - 2 * (SOFTEN_VARIANCE + _BILINEAR_VARIANCE), 0.45**2))
    edge = np.exp(-0.5 * (o / narrow) ** 2)
    pair = np.stack([edge / (edge @ phi), (phi * z) / ((phi * z) @ (phi * z))])
    bank = np.zeros((_SAMPLES, 6))
    bank[:_ENDS, INSIDE] = bank[-_ENDS:, OUTSIDE] = 1 / _ENDS
    bank[:, AREA], bank[:, SECOND] = 1.0, _offsets(1.0)
    bank[:, EDGE], bank[:, BLUR] = pair
    return bank.astype(np.float32), (pair @ ndtr(-z)).astype(np.float32), bank.sum(axis=0).astype(np.float32)


def _filters(step: float, sigma: float) -> tuple[NDArray, Array, Array]:
    """Filter columns (J, 6), what EDGE and BLUR read off a unit step of sd `sigma` at 0, and the columns' sums.

    EDGE and BLUR read delta and dsigma in F(o) + delta phi + dsigma psi, F = Phi(-o/sigma), phi = -dF/do,
    psi = dF/dsigma; one is even and the other odd, so that each ignores the other.
    """
    return _filter_bank(round(step * 100), round(sigma * 100))


def _frame(shape: Array, e: Array) -> tuple[tuple[Array, Array], Array, Array]:
    """Outward normals m (2 x (N, K)), arc per profile (N, K) px, and g = |S^-1 e| (N, K) 1/px, at parameters e (2, K).

    m = S^-1 e/g; the arc is det(S) g dt; the curvature is 1/(det(S)^2 g^3).
    """
    p, q, s = ellipse.inverse_shape(shape).astype(np.float32).T[..., None]
    mx, my = p * e[0] + q * e[1], q * e[0] + s * e[1]
    g = np.sqrt(mx * mx + my * my)
    over = 1 / g
    mx *= over
    my *= over
    return (mx, my), g * (np.float32(2 * np.pi / e.shape[1]) / (p * s - q * q)), g


def _read(source: NDArray, center: Array, shape: Array, e: Array, m: tuple[Array, Array], step: float,
          sigma: float) -> Array:
    """What the filters read off the profiles across the ellipses, outwards: (6, N, K)."""
    p, q, s = shape.astype(np.float32).T[..., None]
    n, k = len(center), e.shape[1]
    line = np.stack([np.ones(_SAMPLES), _offsets(round(step * 100) / 100)]).astype(np.float32)
    start = np.empty((2, n * k, 2), np.float32)
    start[0, :, 0] = (center[:, :1].astype(np.float32) + p * e[0] + q * e[1]).ravel()
    start[1, :, 0] = (center[:, 1:].astype(np.float32) + q * e[0] + s * e[1]).ravel()
    start[0, :, 1], start[1, :, 1] = m[0].ravel(), m[1].ravel()
    maps = (start @ line).reshape(2, n, -1)
    values = cv2.remap(source, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return (_filters(step, sigma)[0].T @ values.reshape(n * k, _SAMPLES).T).reshape(-1, n, k)


def _levels(numbers: Array, e: Array) -> tuple[Array, Array, Array]:
    """Levels (N, K) inside and outside of each profile: per marker, plus a gradient of the light across it.

    Also the sd (2, N) of a single profile's level about them.
    """
    ends = numbers[[INSIDE, OUTSIDE]]
    middle = ends.mean(axis=2, keepdims=True)
    spread = ends - middle
    bound = 2.5 * np.sqrt((spread * spread).mean(axis=2, keepdims=True)) + 1e-3
    spread = np.clip(spread, -bound, bound)
    tilt = (spread @ e.T * (2 / e.shape[1])) @ e
    inside, outside = middle + spread.mean(axis=2, keepdims=True) + tilt
    spread -= tilt
    low = np.abs(inside - outside) < 1.0  # no contrast, no edge; the caller throws such fits away
    return np.where(low, outside - 1.0, inside), outside, np.sqrt((spread * spread).mean(axis=2))


def _move(center: Array, shape: Array, delta: Array, e: Array, arc: Array, g: Array,
          robust: bool = False) -> tuple[Array, Array, Array, Array, Array]:
    """Ellipses moved by least squares to the edge's offsets `delta` (N, K) px along the normals.

    An offset moves e on the unit circle by delta g = e . w + e^T V e, with w = S^-1 dc and V = sym(S^-1 dS): one basis
    for all ellipses, so that all normal matrices are one product. Also returns the inverse normal matrices (N, 5, 5)
    of (w, V), the weights (N, K), and what is left of `delta`.
    """
    basis = np.stack([e[0], e[1], e[0] * e[0], 2 * e[0] * e[1], e[1] * e[1]], axis=1)
    pairs = (basis[:, :, None] * basis[:, None]).reshape(len(basis), 25)
    weight, over = arc, 1 / (g * g)
    scaled = delta * g
    for again in range(2 if robust else 1):
        w = weight * over
        inverse = np.linalg.inv((w @ pairs).reshape(-1, 5, 5).astype(float))
        move = np.einsum("nij,nj->ni", inverse, (w * scaled) @ basis)
        left = delta - (move.astype(np.float32) @ basis.T) / g
        if robust and not again:
            t = left * (1 / np.maximum(6 * np.abs(left).mean(axis=1), 0.08))[:, None]
            weight = arc / (1 + (t * t) ** 2)
    move = np.clip(move, -0.4, 0.4)
    p, q, s = shape.T
    w, V = move[:, :2], move[:, 2:]
    a, b, c = 1 + V[:, 0], V[:, 1], 1 + V[:, 2]
    A, B, C, D = p * a + q * b, p * b + q * c, q * a + s * b, q * b + s * c  # S (I + V); its square root follows
    squared = np.stack([A * A + B * B, A * C + B * D, C * C + D * D], axis=1)
    shift = np.stack([p * w[:, 0] + q * w[:, 1], q * w[:, 0] + s * w[:, 1]], axis=1)
    return center + shift, ellipse.shape_from_moments(squared / 4), inverse, weight, left


def _covariance(shape: Array, inverse: Array) -> Array:
    """Covariance (N, 5, 5) of (u, v, p, q, s) from that of (w, V): dc = S w, and S^-1 dS + dS S^-1 = 2 V."""
    ip, iq, js = ellipse.inverse_shape(shape).T
    M = np.zeros((len(shape), 3, 3))
    M[:, 0, 0], M[:, 0, 1] = ip, iq
    M[:, 1, 0] = M[:, 1, 2] = iq / 2
    M[:, 1, 1] = (ip + js) / 2
    M[:, 2, 1], M[:, 2, 2] = iq, js
    L = np.zeros((len(shape), 5, 5))
    L[:, 0, 0], L[:, 1, 1] = shape[:, 0], shape[:, 2]
    L[:, 0, 1] = L[:, 1, 0] = shape[:, 1]
    L[:, 2:, 2:] = np.linalg.inv(M)
    return L @ inverse @ L.transpose(0, 2, 1)


def _result(center: Array, shape: Array, inverse: Array, weight: Array, left: Array, arc: Array, levels: Array,
            g: Array, common: Array, motion: Array, blur: Array) -> EdgeFit:
    inside, outside = levels
    count = arc.shape[1]
    total = weight.sum(axis=1)
    variance = (weight * left * left).sum(axis=1) / total * (count / (count - 5))
    # Profiles read some of the same pixels: neighbours at distance d correlate as the autocorrelation of softening and
    # interpolation together, nearly a Gaussian. The factor is the sum over all neighbours.
    spacing = arc.mean(axis=1)
    reach = 4 * (SOFTEN_VARIANCE + _BILINEAR_VARIANCE)
    shared = 1 + sum(2 * np.exp(-((k * spacing) ** 2) / reach) for k in range(1, 5))
    variance *= (count - 5) / np.maximum(count - 5 * shared, 1)
    cov = inverse * (_UNMODELLED * variance * shared * spacing)[:, None, None]
    # An error of the levels moves all offsets together, V = I g, and one of their gradient moves the centre, w = g.
    level = common * shared / count * g.mean(axis=1) ** 2
    cov += level[:, None, None] * _LEVEL_MOVES
    cov[:, [2, 3, 4], [2, 3, 4]] += ((_MOTION_DOUBT * motion * g.mean(axis=1)) ** 2)[:, None]
    contrast = np.abs((inside - outside).mean(axis=1))
    # an offset's rms in px, as grey levels at the edge's slope, to compare with the contrast
    residual = np.sqrt(variance) * contrast / (np.sqrt(2 * np.pi) * blur)
    lost = 1 - total / arc.sum(axis=1)
    optical = np.sqrt(np.maximum(blur * blur - SOFTEN_VARIANCE - _BILINEAR_VARIANCE, 0.09))
    return EdgeFit(center, shape, _covariance(shape, cov), inside.mean(axis=1), outside.mean(axis=1), optical, residual,
                   np.full(len(center), float(count)), lost, motion)
