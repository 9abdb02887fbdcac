"""Blurred discs by quadrature, whole patches at a time: the renderer's discs in numpy.

Green's theorem is applied along y instead of x. The tabulated and summed integral is therefore
another one of the same image.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from mjtactile.core import geometry, optics
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array

_SAMPLES = 32
BLUR_MIN_PX = 0.2
# quadrature step along an edge, in sd of the blur: exp(-2 pi^2 / 1.25^2) = 3e-6 of aliasing
_STEP_PER_BLUR = 1.25
# places per pixel at which the edge functions are tabulated: at most 1e-3 px off, at random
_BINS = 512
_STRIPE_PX = 64

Floats = NDArray[np.float32]


def render_discs(
    camera: Camera, p_CM: Array, n_C: Array, radius: ArrayLike, blur_px: float, coverage: Floats
) -> None:
    """Add the blurred area coverage (0-1) of N discs to the image `coverage` (H, W).

    `p_CM` (N, 3) m in C, unit normals `n_C` (N, 3) of either sign, `radius` m one or (N,). Discs
    behind the camera, not entirely beyond the glass or not finite are left out.
    """
    radius = np.broadcast_to(np.asarray(radius, dtype=float), (len(p_CM),))
    angle = np.arange(_SAMPLES) * (2 * np.pi / _SAMPLES)
    a, b = geometry.tangents(n_C)
    rim = np.cos(angle)[:, None] * a[:, None] + np.sin(angle)[:, None] * b[:, None]
    uv = optics.project(camera, p_CM[:, None] + radius[:, None, None] * rim).transpose(0, 2, 1)
    margin = _margin(blur_px)
    blur_px = max(blur_px, BLUR_MIN_PX)
    low = uv.min(axis=2)
    high = uv.max(axis=2)
    seen = np.isfinite(low).all(axis=1) & (high > -margin).all(axis=1)
    seen &= (low < np.array([camera.width, camera.height]) + margin).all(axis=1)
    if not seen.any():
        return
    low = np.floor(low[seen]).astype(int) - margin
    high = np.ceil(high[seen]).astype(int) + margin
    count = (
        8 * int(np.ceil((high - low - 2 * margin).max() * np.pi / (_STEP_PER_BLUR * blur_px) / 8))
        + 16
    )
    between, derivative = _resampling(count)
    curve = (uv[seen] - low[..., None]).reshape(-1, _SAMPLES)
    shape = len(low), 2, count
    xy = (curve @ between.T).reshape(shape)
    rise = (curve[1::2] @ derivative.T).reshape(len(low), count)
    patches = _coverage(xy, rise, ((high - low).max(axis=0) + 1).tolist(), blur_px)
    _paste(coverage, patches, low)


def render_opening(camera: Camera, corners_CP: Array, blur_px: float, coverage: Floats) -> None:
    """Add the blurred area coverage of the polygon `corners_CP` (M, 3) m in C, bent by glass and
    lens, to `coverage`.

    Gauss-Legendre quadrature uses four nodes per two pixels along each straight side. It processes
    one stripe of rows at a time, with the nodes near it.
    """
    node, weight = np.polynomial.legendre.leggauss(4)
    panels = max(camera.width, camera.height) // 2
    t = ((np.arange(panels)[:, None] + (node + 1) / 2) / panels).ravel()[:, None]
    start = corners_CP[:, None]
    side = (np.roll(corners_CP, -1, axis=0) - corners_CP)[:, None]
    h = 1e-5  # of a side; the curve is smooth: truncation h^2
    uv, ahead, behind = (
        optics.project(camera, start + side * s).reshape(-1, 2) for s in (t, t + h, t - h)
    )
    rise = (
        (ahead - behind)[:, 1] / (2 * h) * np.tile(weight, panels * len(corners_CP)) / (2 * panels)
    )
    border = _margin(blur_px) + 1
    for v in range(0, camera.height, _STRIPE_PX):
        rows = min(_STRIPE_PX, camera.height - v)
        near = (uv[:, 1] > v - border) & (uv[:, 1] < v + rows + border)
        xy = (uv[near] - np.array([0.0, v])).T[None]
        coverage[v : v + rows] += _coverage(
            xy, rise[None, near], (camera.width, rows), max(blur_px, BLUR_MIN_PX)
        )[0]


def _margin(blur_px: float) -> int:
    # the Gaussian's tail beyond 4.5 sd is 7e-6
    return int(np.ceil(4.5 * max(blur_px, BLUR_MIN_PX))) + 1


def _resampling(count: int) -> tuple[Array, Array]:
    """Return trigonometric interpolation (count, _SAMPLES) from equally spaced samples of a period
    to `count` points, and the same for the curve's derivative times the period / count."""
    if count not in _RESAMPLING:
        angle = np.arange(count)[:, None] * (2 * np.pi / count) - np.arange(_SAMPLES) * (
            2 * np.pi / _SAMPLES
        )
        k = np.arange(1, _SAMPLES // 2)
        phase = angle[..., None] * k
        _RESAMPLING[count] = (
            (1 + 2 * np.cos(phase).sum(axis=-1)) / _SAMPLES,
            -2 * (k * np.sin(phase)).sum(axis=-1) / _SAMPLES * (2 * np.pi / count),
        )
    return _RESAMPLING[count]


def _coverage(xy: Array, rise: Array, size: Sequence[int], blur_px: float) -> Floats:
    """Compute the blurred area coverage (N, size_y, size_x) of the interiors of N closed curves by
    Green's theorem; `size` is in pixels (x, y).

    `xy` (N, 2, K) px are quadrature nodes along each curve, `rise` (N, K) the weight times dy. With
    the point spread function h(x) h(y), h = pixel * Gaussian, and H its integral,

        coverage(u, v) = integral over the interior of h(u - x) h(v - y) dx dy
                       = - closed integral of H(u - x) h(v - y) dy.

    The integrand is smooth, so that the rule converges exponentially for a smooth curve. It is a
    product of a function of u and one of v, so that the sum over nodes is a matrix product. The
    sign is the curve's orientation.
    """
    width, height = size
    across = _table(width, blur_px, integral=True)[_table_rows(xy[:, 0], width, blur_px)]
    down = _table(height, blur_px, integral=False)[_table_rows(xy[:, 1], height, blur_px)]
    down = down * rise[..., None].astype(np.float32)
    return np.abs(down.transpose(0, 2, 1) @ across)


def _table_rows(x: Array, pixels: int, blur_px: float) -> NDArray[np.int64]:
    """Return rows of `_table` for curve points `x`; beyond its reach the functions are constant."""
    border = _margin(blur_px) + 1
    place = np.rint((np.clip(x, -border, pixels - 1 + border) + border) * _BINS).astype(np.int64)
    pixel = place // _BINS
    part = place % _BINS
    return part * (2 * pixels + 2 * border) + (pixels + 2 * border - 1) - pixel


def _table(pixels: int, blur_px: float, *, integral: bool) -> Floats:
    """Return a read-only window view (rows, pixels): row r holds h or H(u - x) at pixels u = 0, 1,
    ... for the x of row r."""
    key = pixels, blur_px, integral
    if key not in _TABLES:
        if len(_TABLES) > 128:
            _TABLES.clear()
        border = _margin(blur_px) + 1
        sd = blur_px
        u = (
            np.arange(2 * pixels + 2 * border)
            - (pixels + border - 1)
            - np.arange(_BINS)[:, None] / _BINS
        )
        edge = np.stack([u + 0.5, u - 0.5])
        value = ndtr(edge / sd)
        if integral:
            value = edge * value + sd * np.exp(-0.5 * (edge / sd) ** 2) / np.sqrt(2 * np.pi)
        flat = (value[0] - value[1]).astype(np.float32).ravel()
        flat[np.abs(flat) < _NOTHING] = 0.0
        _TABLES[key] = np.lib.stride_tricks.sliding_window_view(flat, pixels)
    return _TABLES[key]


_NOTHING = 1e-12
"""Share of a pixel below which a tail is none. Its denormal numbers make the matrix product up to
20 times slower on some processors, and no image differs by a bit without them."""
_RESAMPLING: dict[int, tuple[Array, Array]] = {}
_TABLES: dict[tuple[int, float, bool], Floats] = {}


def _paste(image: Floats, patches: Floats, corners: NDArray[np.int64]) -> None:
    """Add patches (N, h, w) to `image` with their first pixels at `corners` (N, 2) (u, v), cut at
    the image's border."""
    height, width = patches.shape[1:]
    v_end, u_end = image.shape
    for (u, v), patch in zip(corners.tolist(), patches, strict=True):
        if u >= 0 and v >= 0 and u + width <= u_end and v + height <= v_end:
            image[v : v + height, u : u + width] += patch
        else:
            u0 = max(u, 0)
            v0 = max(v, 0)
            u1 = min(u + width, u_end)
            v1 = min(v + height, v_end)
            if u0 < u1 and v0 < v1:
                image[v0:v1, u0:u1] += patch[v0 - v : v1 - v, u0 - u : u1 - u]
