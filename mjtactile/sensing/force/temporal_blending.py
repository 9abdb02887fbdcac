"""Detection of cameras that blend several images: temporal noise reduction, a rolling shutter.

Then each image still contains the previous one, and motion is measured with a delay. Blending is
detected from the marker noise without motion. The noise of two images is independent, unless a
fraction `a` of the next image is the last one. Successive image differences then have the
correlation r1 = -(1 - a) / 2 instead of -1/2, and differences two images apart r2 = a r1. Motion
is smooth over the membrane and noise is not. A polynomial removes the motion. If it removes more
than noise would contribute, there is motion.

The polynomial leaves a part of slow, local motion, such as creep of a small object. That part is
the same in successive differences. If it contributes the fraction M of their squares,

    1 - r1 = (1 - M) (3 - a) / 2,    1 - r2 = (1 - M) (2 - a) (1 + a) / 2

and both equations give `a`. It is less exact than that of r1 alone, which is used unless r2 shows
motion.

Rounding to whole gray levels adds noise, which makes a large `a` appear smaller.
"""

from __future__ import annotations

import math
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
_SIGNIFICANT = 4.0  # standard deviations of r2 that show motion
_MOTION_MAX = 0.5  # fraction M of motion up to which the noise shows blending
_MAX = 0.95
_SURE = 0.15  # minimum fraction: three standard deviations with 16 markers, ten with 81


@dataclass(frozen=True, eq=False)
class Blend:
    """Blending information from the images so far. `p` (m, 3), m, are the positions of the markers
    `ids` in the last image. `moved` (m, 3) is their motion in standard deviations, without its
    smooth part (None: something moved), and `earlier` that of the image before. The others are sums
    over still images: of products of successive motions and of those two images apart, of their
    squares, and of images."""

    ids: NDArray[np.int64]
    p: Array
    moved: Array | None = None
    earlier: Array | None = None
    products: float = 0.0
    products_apart: float = 0.0
    squares: float = 0.0
    count: float = 0.0

    @property
    def fraction(self) -> float:
        """Fraction of the previous image in each image; 0 if unknown or not significant."""
        if self.count < _ENOUGH or self.squares <= 0 or not len(self.ids):
            return 0.0
        r1, r2 = self.products / self.squares, self.products_apart / self.squares
        fraction = 1 + 2 * r1
        sd = 1 / math.sqrt(3 * len(self.ids) * self.count)
        if r2 - min(fraction, 1.0) * min(r1, 0.0) > _SIGNIFICANT * sd:
            ratio = min((1 - r2) / max(1 - r1, 1e-9), 1.0)
            fraction = (1 + ratio - math.sqrt((1 - ratio) * (9 - ratio))) / 2
            if 1 - 2 * (1 - r1) / (3 - fraction) > _MOTION_MAX:
                return 0.0
        return min(fraction, _MAX) if fraction > _SURE else 0.0

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
            before,
            ids=markers.ids,
            p=markers.p_SM,
            moved=self._motion_in_sds(before, markers),
            earlier=before.moved,
        )
        moved, last, earlier = observed.moved, before.moved, before.earlier
        if moved is None or last is None or earlier is None:
            return observed
        if not len(moved) == len(last) == len(earlier):
            return observed
        squares = (np.square(moved).sum() + np.square(last).sum()) / 2
        return replace(
            observed,
            products=_KEPT * before.products + float((moved * last).sum()),
            products_apart=_KEPT * before.products_apart + float((moved * earlier).sum()),
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
