"""Where markers may be: Suzuki-Abe borders on a local threshold, and the area moments of each border.

All borders are handled in one ragged array; nothing here is more precise than about half a pixel, on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.settings import DEFAULTS, CandidateSettings

_DIVISORS = np.array([[2.0], [6.0], [6.0], [12.0], [24.0], [12.0]])  # of the polygon's moments


@dataclass(frozen=True)
class Candidates:
    """N borders: `center` (N, 2), `shape` (N, 3) of the ellipse with the same moments, `misfit` (N,) the largest
    distance of the border from that ellipse in px, `cut` (N,) whether it touches the image's edge."""

    center: Array
    shape: Array
    misfit: Array
    cut: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.center)

    def take(self, keep: NDArray[np.bool_]) -> Candidates:
        return self if keep.all() else Candidates(self.center[keep], self.shape[keep], self.misfit[keep], self.cut[keep])

    def joined(self, more: Candidates) -> Candidates:
        """These and then `more`."""
        return Candidates(*(np.concatenate([a, b]) for a, b in zip(vars(self).values(), vars(more).values(), strict=True)))


_NONE = Candidates(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=bool))


def find(dark: NDArray[np.uint8], min_radius_px: float, s: CandidateSettings = DEFAULTS.candidates) -> Candidates:
    """Candidates for dark blobs in an 8-bit image (H, W) with semi-axes of at least about `min_radius_px`."""
    if min_radius_px >= s.half_from and min(dark.shape) >= 4 * s.cells:
        height, width = (side // 2 for side in dark.shape)
        half = cv2.resize(dark[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
        found = find(half, min_radius_px / 2, s)
        # the middle of the first 2 x 2 pixels is at (0.5, 0.5)
        return Candidates(2 * found.center + 0.5, 2 * found.shape, 2 * found.misfit, found.cut)
    return outlines(threshold(dark, s), min_radius_px, s)


def outlines(binary: NDArray[np.uint8], min_radius_px: float, s: CandidateSettings) -> Candidates:
    """The blobs of a binary image (H, W) as candidates."""
    borders, tree = cv2.findContours(binary, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if not borders:
        return _NONE
    # Outer borders only (no parent): a disc larger than the threshold's neighbourhood comes out hollow. Straight runs
    # are given by their ends; less than six corners are no disc.
    counts = np.fromiter(map(len, borders), np.int64, len(borders))
    keep = (tree[0, :, 3] < 0) & (counts > 5)
    if not keep.any():
        return _NONE
    if not keep.all():
        borders, counts = [borders[i] for i in np.flatnonzero(keep)], counts[keep]
    found = _moments(np.concatenate(borders), counts, binary.shape)
    a, b, c = found.shape.T
    return found.take(a * c - b * b > (s.smallest * min_radius_px) ** 2)


def threshold(dark: NDArray[np.uint8], s: CandidateSettings = DEFAULTS.candidates) -> NDArray[np.uint8]:
    """Binary image: what is darker than the mean of its neighbourhood, by a margin."""
    height, width = dark.shape
    small = dark
    while min(small.shape) >= 1.5 * s.cells:  # halving is what cv2 does fastest
        small = cv2.resize(small, (small.shape[1] // 2, small.shape[0] // 2), interpolation=cv2.INTER_AREA)
    small = cv2.blur(small, (5, 5))
    soft = cv2.GaussianBlur(dark, (3, 3), 0)
    margin = cv2.max(small // 24, noise_margin(soft, s))
    local = cv2.resize(cv2.subtract(small, margin), (width, height), interpolation=cv2.INTER_LINEAR)
    return cv2.compare(soft, local, cv2.CMP_LT)


def noise_margin(soft: NDArray[np.uint8], s: CandidateSettings) -> float:
    """Several times the noise left in `soft`, from the median difference of neighbours on some of the rows."""
    rows = soft[:: max(1, soft.shape[0] // 16)]
    histogram = cv2.calcHist([cv2.absdiff(rows[:, 1:], rows[:, :-1])], [0], None, [256], [0, 256]).ravel()
    below = histogram.cumsum()
    return float(min(max(s.noise * below.searchsorted(below[-1] / 2), s.margins[0]), s.margins[1]))


def _moments(points: NDArray[np.int32], counts: NDArray[np.int64], size: tuple[int, ...]) -> Candidates:
    """Area moments of all borders at once, by Green's theorem on the polygons through their pixels' centres.

    `points` (P, 1, 2) of one border after the other, `counts` (N,) of them.
    """
    ends = counts.cumsum() - 1
    starts = ends - counts + 1
    xy = points[:, 0].T.astype(float)
    following = np.empty_like(xy)
    following[:, :-1] = xy[:, 1:]
    following[:, ends] = xy[:, starts]
    (x, y), (x2, y2) = xy, following
    sx, sy = x + x2, y + y2
    terms = np.empty((6, len(x)))
    cross = np.subtract(x * y2, x2 * y, out=terms[0])
    terms[1], terms[2] = cross * sx, cross * sy
    terms[3], terms[5] = cross * (sx * sx - x * x2), cross * (sy * sy - y * y2)
    terms[4] = cross * (sx * sy + x * y + x2 * y2)
    area, mx, my, mxx, mxy, myy = np.add.reduceat(terms, starts, axis=1) / _DIVISORS
    # A one-pixel-wide border has no area; it is no marker either, so that any non-zero stand-in will do.
    flat = np.abs(area) < 0.5
    area[flat] = 1.0
    cx, cy = mx / area, my / area
    second = np.array([mxx / area - cx * cx, mxy / area - cx * cy, myy / area - cy * cy]).T
    second[flat] = [0.01, 0.0, 0.01]
    shape = ellipse.shape_from_moments(second)
    # The polygon runs through centres of boundary pixels, half a pixel inside of the blob's outline.
    shape += [0.5, 0.0, 0.5]
    center = np.array([cx, cy]).T
    misfit = np.maximum.reduceat(_distance(xy, center, shape, counts), starts)
    misfit[flat] = np.inf
    room = np.minimum(np.minimum(x, y), np.minimum(size[1] - 1 - x, size[0] - 1 - y))
    return Candidates(center, shape, misfit, np.minimum.reduceat(room, starts) <= 0)


def _distance(xy: Array, center: Array, shape: Array, counts: NDArray[np.int64]) -> Array:
    """First-order distance |(rho - 1)/|S^-1 e|| (P,) of border points `xy` (2, P) from their ellipses; the blob's outline
    is half a pixel further out than they are."""
    own = np.concatenate([center.T, ellipse.inverse_shape(shape).T]).repeat(counts, axis=1)
    dx, dy = xy - own[:2]
    p, q, s = own[2:]
    ex, ey = p * dx + q * dy, q * dx + s * dy
    rho2 = ex * ex + ey * ey
    mx, my = p * ex + q * ey, q * ex + s * ey
    return np.abs((rho2 - np.sqrt(rho2)) / np.sqrt(mx * mx + my * my + 1e-18) + 0.5)
