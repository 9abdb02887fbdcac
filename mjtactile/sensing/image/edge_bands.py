"""Pixels used by a marker's fit: a band along its edge, without pixels darkened by other markers.

All in ragged arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.settings import EdgeSettings

_FAR = 1e7  # px; beyond any image


def band(
    size: tuple[int, int], center: Array, shape: Array, width: float
) -> tuple[NDArray, NDArray, NDArray]:
    """Return the pixels within +-`width` of each ellipse. They are flat lists `u`, `v`, and
    `counts` (N,) of pixels per ellipse. Each image row intersects the outer and the inner ellipse
    in at most one interval each."""
    outer = shape + [width, 0, width]
    inner = shape - [width, 0, width]
    hollow = (inner[:, 0] > 0) & (inner[:, 0] * inner[:, 2] > inner[:, 1] ** 2)
    extent = np.sqrt(outer[:, 1] ** 2 + outer[:, 2] ** 2)
    top = np.ceil(center[:, 1] - extent).astype(np.int64)
    rows = int(np.ceil(2 * extent.max())) + 1
    v = top[:, None] + np.arange(rows)
    left, right = _chord(outer, v - center[:, 1:], center[:, :1])
    hole_left, hole_right = _chord(
        np.where(hollow[:, None], inner, [1e-3, 0, 1e-3]), v - center[:, 1:], center[:, :1]
    )
    inside_rows = (v >= 0) & (v < size[0])
    left = np.maximum(np.ceil(left), 0)
    right = np.minimum(np.floor(right), size[1] - 1)
    holed = hollow[:, None] & (hole_right > hole_left)
    center_left = np.where(holed, np.minimum(np.floor(hole_left), right), right)
    center_right = np.where(holed, np.maximum(np.ceil(hole_right), left), right + 1)
    center_right = np.maximum(center_right, center_left + 1)
    start = np.stack([left, center_right], axis=-1)
    length = np.stack([center_left - left + 1, right - center_right + 1], axis=-1)
    length = np.where(inside_rows[..., None], np.maximum(length, 0), 0).astype(np.int64)
    start = np.where(length > 0, start, 0).astype(np.int64)
    counts = length.sum(axis=(1, 2))
    flat = length.ravel()
    ends = np.cumsum(flat)
    total = int(ends[-1]) if len(ends) else 0
    u = np.arange(total) + np.repeat(start.ravel() - (ends - flat), flat)
    return u, np.repeat(np.repeat(v.ravel(), 2), flat), counts


def _chord(shape: Array, dy: Array, u0: Array) -> tuple[Array, Array]:
    """Return the intersections of rows at `dy` (N, R) from the center with the ellipses. The
    interval is empty if there is no intersection."""
    p, q, s = ellipse.inverse_shape(shape).T[..., None]
    A = p * p + q * q
    B = q * (p + s)
    C = q * q + s * s
    under = (B * dy) ** 2 - A * (C * dy * dy - 1)
    half = np.sqrt(np.maximum(under, 0)) / A
    center = u0 - B * dy / A
    return np.where(under > 0, center - half, _FAR), np.where(under > 0, center + half, -_FAR)


class Pixels:
    """Pixels of some markers as flat float32 arrays. `x` and `y` are relative to each marker's
    origin. The others are `observed`, and the bounds of each marker's range."""

    def __init__(self, x: NDArray, y: NDArray, observed: NDArray, counts: NDArray):
        self.x = x
        self.y = y
        self.observed = observed
        self.counts = counts
        self.starts = np.cumsum(counts) - counts

    def sums(self, values: NDArray) -> Array:
        """Sum `values` (..., P) per marker, (..., n)."""
        return np.add.reduceat(values, self.starts, axis=-1)

    def spread(self, values: Array) -> NDArray:
        """Repeat per-marker `values` (..., n) for each pixel, (..., P)."""
        return np.repeat(values.astype(np.float32), self.counts, axis=-1)


@dataclass(frozen=True)
class NeighborMarkers:
    """Markers with `center` (M, 2) and `shape` (M, 3) that may darken the band of another one.
    `near` (N, k) holds their indices for each of N markers, padded with -1. `margin`, px, is the
    darkened zone next to their edges."""

    center: Array
    shape: Array
    near: NDArray[np.int64]
    margin: float

    @classmethod
    def of(
        cls, center: Array, shape: Array, count: int, width: float, s: EdgeSettings
    ) -> NeighborMarkers:
        """Find the neighbors of the first `count` markers, whose bands are +-`width` px."""
        near = np.full((count, 0), -1, dtype=np.int64)
        if len(center) < 2:
            return cls(center, shape, near, s.neighbour_margin)
        extent = np.hypot(shape[:, [0, 2]], shape[:, 1:2]).max(axis=1)
        own = extent[:count]
        reach = own + np.minimum(s.max_size_ratio * own, extent.max()) + width
        i, j = pairs_within(center, center[:count], reach + s.neighbour_margin)
        distance = np.hypot(*(center[i] - center[j]).T)
        close = distance < (extent[i] + extent[j] + width + s.neighbour_margin)
        # exclude the marker itself, and objects it lies on, such as a sheet of paper
        close &= (distance > np.maximum(extent[i], s.min_distance_fraction * extent[j])) & (
            extent[j] < s.max_size_ratio * extent[i]
        )
        order = np.flatnonzero(close)[np.argsort(i[close], kind="stable")]
        i = i[order]
        j = j[order]
        counts = np.bincount(i, minlength=count)
        near = np.full((count, int(counts.max(initial=0))), -1, dtype=np.int64)
        near[i, np.arange(len(i)) - np.repeat(np.cumsum(counts) - counts, counts)] = j
        return cls(center, shape, near, s.neighbour_margin)

    def part(self, first: int, last: int) -> NeighborMarkers:
        return NeighborMarkers(self.center, self.shape, self.near[first:last], self.margin)

    def clear(self, u: NDArray, v: NDArray, counts: NDArray) -> NDArray[np.bool_]:
        """Return a mask of the band pixels (P,) at least `margin` px from every neighbor's edge."""
        clear = np.ones(len(u), dtype=bool)
        grown = ellipse.inverse_shape(self.shape + [self.margin, 0.0, self.margin])
        marker, column = np.nonzero(self.near >= 0)
        own = counts[marker]  # pixels of each pair of a marker and a neighbor
        before = np.cumsum(own) - own
        first = (np.cumsum(counts) - counts)[marker]
        pixel = np.arange(int(own.sum())) + np.repeat(first - before, own)
        neighbor = self.near[marker, column]
        cu, cv = np.repeat(self.center[neighbor].T, own, axis=1)
        p, q, s = np.repeat(grown[neighbor].T, own, axis=1)
        dx = u[pixel] - cu
        dy = v[pixel] - cv
        dark = (p * dx + q * dy) ** 2 + (q * dx + s * dy) ** 2 <= 1
        clear[pixel[dark]] = False
        return clear


def pairs_within(points: Array, centers: Array, radii: Array) -> tuple[NDArray, NDArray]:
    """Return the pairs (i, j) of `centers` (N, 2) and other `points` (M, 2) within `radii` (N,).
    The centers are the first N points. One large radius does not make pairs of all others."""
    # lazily: a tenth of a second, and only small markers need it
    from scipy.spatial import KDTree

    found = KDTree(points).query_ball_point(centers, radii)
    counts = np.fromiter(map(len, found), np.int64, len(found))
    i = np.repeat(np.arange(len(found)), counts)
    j = np.fromiter(chain.from_iterable(found), np.int64, int(counts.sum()))
    return i[i != j], j[i != j]
