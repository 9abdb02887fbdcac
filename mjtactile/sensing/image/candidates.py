"""Marker candidates: Suzuki-Abe borders on a local threshold, and the area moments of each border.

The accuracy is deliberately only about half a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.sensing.settings import DEFAULTS, CandidateSettings


@dataclass(frozen=True)
class Candidates:
    """N borders: `center` (N, 2), and `shape` (N, 3) of the ellipse with the same moments. `misfit`
    (N,) is the maximum distance of the border from that ellipse, px. `cut` (N,) is True if it
    touches the image border."""

    center: Array
    shape: Array
    misfit: Array
    cut: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.center)

    def take(self, keep: NDArray[np.bool_]) -> Candidates:
        if keep.all():
            return self
        return Candidates(self.center[keep], self.shape[keep], self.misfit[keep], self.cut[keep])

    def joined(self, more: Candidates) -> Candidates:
        """Return these candidates followed by `more`."""
        return Candidates(
            *(
                np.concatenate([a, b])
                for a, b in zip(vars(self).values(), vars(more).values(), strict=True)
            )
        )


_NONE = Candidates(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=bool))


def find(
    dark: NDArray[np.uint8], min_radius_px: float, s: CandidateSettings = DEFAULTS.candidates
) -> Candidates:
    """Find candidates for dark blobs in an 8-bit image (H, W). Their semi-axes are at least about
    `min_radius_px`."""
    if min_radius_px >= s.half_from and min(dark.shape) >= 4 * s.cells:
        height, width = (side // 2 for side in dark.shape)
        half = cv2.resize(
            dark[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA
        )
        found = find(half, min_radius_px / 2, s)
        # the center of the first 2 x 2 pixels is at (0.5, 0.5)
        return Candidates(2 * found.center + 0.5, 2 * found.shape, 2 * found.misfit, found.cut)
    return outlines(threshold(dark, s), min_radius_px, s)


def outlines(binary: NDArray[np.uint8], min_radius_px: float, s: CandidateSettings) -> Candidates:
    """Return the blobs of a binary image (H, W) as candidates."""
    borders, tree = cv2.findContours(binary, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if not borders:
        return _NONE
    # Outer borders only (no parent): a disc larger than the threshold's neighborhood becomes
    # hollow. Straight runs are stored by their ends; fewer than six corners are not a disc.
    counts = np.fromiter(map(len, borders), np.int64, len(borders))
    keep = (tree[0, :, 3] < 0) & (counts > 5)
    if not keep.any():
        return _NONE
    if not keep.all():
        borders = [borders[i] for i in np.flatnonzero(keep)]
        counts = counts[keep]
    found = _moments(np.concatenate(borders), counts, binary.shape)
    a, b, c = found.shape.T
    return found.take(a * c - b * b > (s.smallest * min_radius_px) ** 2)


def threshold(
    dark: NDArray[np.uint8], s: CandidateSettings = DEFAULTS.candidates
) -> NDArray[np.uint8]:
    """Return a binary image of the pixels darker than their neighborhood mean by a margin."""
    height, width = dark.shape
    small = dark
    while min(small.shape) >= 1.5 * s.cells:  # halving is the fastest resize in cv2
        small = cv2.resize(
            small, (small.shape[1] // 2, small.shape[0] // 2), interpolation=cv2.INTER_AREA
        )
    small = cv2.blur(small, (5, 5))
    soft = cv2.GaussianBlur(dark, (3, 3), 0)
    margin = cv2.max(small // 24, noise_margin(soft, s))
    local = cv2.resize(cv2.subtract(small, margin), (width, height), interpolation=cv2.INTER_LINEAR)
    return cv2.compare(soft, local, cv2.CMP_LT)


def noise_margin(soft: NDArray[np.uint8], s: CandidateSettings) -> float:
    """Return a multiple of the noise in `soft`, from the median difference of neighbors in some
    rows."""
    rows = soft[:: max(1, soft.shape[0] // 16)]
    histogram = cv2.calcHist(
        [cv2.absdiff(rows[:, 1:], rows[:, :-1])], [0], None, [256], [0, 256]
    ).ravel()
    below = histogram.cumsum()
    return float(min(max(s.noise * below.searchsorted(below[-1] / 2), s.margins[0]), s.margins[1]))


def _moments(
    points: NDArray[np.int32], counts: NDArray[np.int64], size: tuple[int, ...]
) -> Candidates:
    """Compute the area moments of all borders, by Green's theorem on polygons through pixel
    centers. `points` (P, 1, 2) of all borders are consecutive, with `counts` (N,) each."""
    n = len(counts)
    center = np.empty((n, 2))
    shape = np.empty((n, 3))
    misfit = np.empty(n)
    cut = np.empty(n, np.int64)
    kernel("border_moments")(n, counts, len(points), points, *size, center, shape, misfit, cut)
    return Candidates(center, shape, misfit, cut != 0)
