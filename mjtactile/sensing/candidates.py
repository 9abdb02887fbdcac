"""Where markers may be: Suzuki-Abe borders on a local threshold, and the area moments of each border.

All borders are handled in one ragged array; nothing here is more precise than about half a pixel, on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.sensing import ellipse
from mjtactile.types import Array

_CELLS = 60  # the threshold's grid has about this many cells along the image's shorter side
_MARGINS = (3.0, 24.0)  # how much darker than its neighbourhood, at 8 bit: least; most that noise can ask for


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

    def take(self, keep: NDArray) -> Candidates:
        return Candidates(self.center[keep], self.shape[keep], self.misfit[keep], self.cut[keep])


def find(dark: NDArray[np.uint8], min_radius_px: float) -> Candidates:
    """Candidates for dark blobs in an 8-bit image (H, W) with semi-axes of at least about `min_radius_px`."""
    binary = threshold(dark)
    borders, tree = cv2.findContours(binary, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    # Outer borders only (no parent): a disc larger than the threshold's neighbourhood comes out hollow. Straight runs
    # are given by their ends; less than six corners are no disc.
    borders = [b for b, links in zip(borders, tree[0], strict=True) if links[3] < 0 and len(b) > 5] if borders else []
    if not borders:
        empty = np.zeros(0)
        return Candidates(np.zeros((0, 2)), np.zeros((0, 3)), empty, empty.astype(bool))
    found = _moments(borders, dark.shape)
    return found.take(found.shape[:, 0] * found.shape[:, 2] - found.shape[:, 1] ** 2 > (0.7 * min_radius_px) ** 2)


def threshold(dark: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Binary image: what is darker than the mean of its neighbourhood, by a margin."""
    height, width = dark.shape
    cell = max(1, round(min(height, width) / _CELLS))
    small = cv2.resize(dark, (max(1, width // cell), max(1, height // cell)), interpolation=cv2.INTER_AREA)
    small = cv2.blur(small, (5, 5))
    soft = cv2.GaussianBlur(dark, (3, 3), 0)
    margin = np.clip(small // 24, _margin(soft), 255).astype(np.uint8)
    local = cv2.resize(cv2.subtract(small, margin), (width, height), interpolation=cv2.INTER_LINEAR)
    return cv2.compare(soft, local, cv2.CMP_LT)


def _margin(soft: NDArray[np.uint8]) -> float:
    """Several times the noise left in `soft`, from the median difference of neighbours on some of the rows."""
    rows = soft[:: max(1, soft.shape[0] // 40)]
    histogram = cv2.calcHist([cv2.absdiff(rows[:, 1:], rows[:, :-1])], [0], None, [256], [0, 256]).ravel()
    median = np.searchsorted(np.cumsum(histogram), histogram.sum() / 2)
    return float(np.clip(4 * median, *_MARGINS))


def _moments(borders: list[NDArray], size: tuple[int, ...]) -> Candidates:
    """Area moments of all borders at once, by Green's theorem on the polygons through their pixels' centres."""
    counts = np.array([len(b) for b in borders])
    points = np.concatenate(borders)[:, 0].astype(np.float32)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    origin = points[starts]
    x, y = (points - np.repeat(origin, counts, axis=0)).T
    following = np.arange(1, len(points) + 1)
    following[starts + counts - 1] = starts
    x2, y2 = x[following], y[following]
    cross = x * y2 - x2 * y
    terms = np.stack([cross, cross * (x + x2), cross * (y + y2), cross * (x * x + x * x2 + x2 * x2),
                      cross * (2 * x * y + x * y2 + x2 * y + 2 * x2 * y2), cross * (y * y + y * y2 + y2 * y2)])
    sums = np.add.reduceat(terms, starts, axis=1).astype(float)
    area, mx, my, mxx, mxy, myy = sums / np.array([[2.0], [6.0], [6.0], [12.0], [24.0], [12.0]])
    # A one-pixel-wide border has no area; it is no marker either, so that any non-zero stand-in will do.
    flat = np.abs(area) < 0.5
    area = np.where(flat, 1.0, area)
    cx, cy = mx / area, my / area
    second = np.stack([mxx / area - cx * cx, mxy / area - cx * cy, myy / area - cy * cy], axis=1)
    second[flat] = [0.01, 0.0, 0.01]
    shape = ellipse.shape_from_moments(second)
    # The polygon runs through centres of boundary pixels, half a pixel inside of the blob's outline.
    shape += [0.5, 0.0, 0.5]
    inverse = np.repeat(ellipse.inverse_shape(shape).T.astype(np.float32), counts, axis=1)
    dx, dy = x - np.repeat(cx.astype(np.float32), counts), y - np.repeat(cy.astype(np.float32), counts)
    ex, ey = inverse[0] * dx + inverse[1] * dy, inverse[1] * dx + inverse[2] * dy
    # first-order distance (rho - 1)/|S^-1 e| from the ellipse, of the outline half a pixel further out
    rho = np.sqrt(ex * ex + ey * ey) + 1e-9
    slope = np.hypot(inverse[0] * ex + inverse[1] * ey, inverse[1] * ex + inverse[2] * ey) / rho + 1e-9
    misfit = np.maximum.reduceat(np.abs((rho - 1) / slope + 0.5), starts)
    low = np.minimum.reduceat(points, starts, axis=0)
    high = np.maximum.reduceat(points, starts, axis=0)
    cut = np.any((low <= 0) | (high >= np.array([size[1] - 1, size[0] - 1])), axis=1)
    cut = np.asarray(cut, dtype=bool)
    misfit[flat] = np.inf
    return Candidates(np.stack([cx, cy], axis=1) + origin, shape, misfit, cut)
