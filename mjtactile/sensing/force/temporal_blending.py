"""Detection of cameras that blend several images: temporal noise reduction, a rolling shutter.

Then each image still contains the previous one, and motion is measured with a delay. Blending is
detected from the marker noise without motion. The noise of two images is independent, unless a
fraction `a` of the next image is the last one. Successive image differences then have the
correlation -(1 - a) / 2 instead of -1/2. Motion is smooth over the membrane and noise is not. A
polynomial removes the motion. If it removes more than noise would contribute, there is motion.

Rounding to whole gray levels adds noise, which makes a large `a` appear smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Markers

_DEGREE_MAX = 5
_MARKERS_TO_A_TERM = 3
# maximum mean square of a still image over that of the noise, which the polynomial may reduce
_STILL = 1.5
_KEPT = 0.95  # memory factor per still image: 20 of them count
_ENOUGH = 6.0  # minimum number of still images, by weight
_SURE = 0.15  # minimum fraction: three standard deviations with 16 markers, ten with 81


@dataclass(frozen=True, eq=False)
class Blend:
    """Blending information from the images so far. `p` (m, 3), m, are the positions of the markers
    `ids` in the last image. `moved` (m, 3) is their motion in standard deviations, without its
    smooth part (None: something moved). The others are sums over still images: of products of
    successive motions, of their squares, and of images."""

    ids: NDArray[np.int64]
    p: Array
    moved: Array | None = None
    products: float = 0.0
    squares: float = 0.0
    count: float = 0.0

    @property
    def fraction(self) -> float:
        """Fraction of the previous image in each image; 0 if unknown or not significant."""
        if self.count < _ENOUGH or self.squares <= 0:
            return 0.0
        fraction = 1 + 2 * self.products / self.squares
        return min(fraction, 0.95) if fraction > _SURE else 0.0

    @property
    def images(self) -> float:
        """Delay of the measured motion, in images."""
        return self.fraction / (1 - self.fraction)


class BlendEstimator:
    """Blending estimator for the images of one sensor with N markers at `p_SM` (N, 3), m.
    Stateless."""

    def __init__(self, p_SM: Array):
        degree = _degree(len(p_SM))
        powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        x, y = (p_SM[:, :2] / np.abs(p_SM[:, :2]).max()).T
        self._terms = np.column_stack([x**i * y**j for i, j in powers])
        self._smooth = np.linalg.qr(self._terms)[0]

    def after(self, before: Blend | None, markers: Markers) -> Blend:
        """Return the blending information after an image with these markers. It gains nothing from
        an image with other markers than the last."""
        observed = Blend(markers.ids, markers.p_SM)
        if before is None:
            return observed
        observed = replace(
            before, ids=markers.ids, p=markers.p_SM, moved=self._motion_in_sds(before, markers)
        )
        if (
            observed.moved is None
            or before.moved is None
            or len(observed.moved) != len(before.moved)
        ):
            return observed
        squares = (np.square(observed.moved).sum() + np.square(before.moved).sum()) / 2
        return replace(
            observed,
            products=_KEPT * before.products + float((observed.moved * before.moved).sum()),
            squares=_KEPT * before.squares + float(squares),
            count=_KEPT * before.count + 1,
        )

    def _motion_in_sds(self, before: Blend, markers: Markers) -> Array | None:
        """Return the marker motion since `before` (m, 3), in standard deviations, without its
        smooth part. Return None if the markers are others, or really move."""
        if not np.array_equal(before.ids, markers.ids) or not len(markers.ids):
            return None
        sd = np.sqrt(np.diagonal(markers.cov_p, axis1=1, axis2=2))
        moved = (markers.p_SM - before.p) / sd
        basis = self._smooth
        if len(moved) < len(basis):
            basis = np.linalg.qr(self._terms[markers.ids])[0]
        left = len(moved) - basis.shape[1]
        smooth = basis.T @ moved
        rest = moved - basis @ smooth
        noise = float(np.square(rest).sum()) / (3 * max(left, 1))
        is_still = np.square(smooth).mean() < _STILL * noise  # not of NaN
        return rest if left >= 1 and is_still else None


def _degree(markers: int) -> int:
    """Return the degree of the polynomial: the highest that this number of markers supports."""
    for degree in range(_DEGREE_MAX, 0, -1):
        terms = (degree + 1) * (degree + 2) // 2
        if _MARKERS_TO_A_TERM * terms <= markers:
            return degree
    return 0
