"""Whether a camera's pictures are blends of several: temporal noise reduction, a rolling shutter.

What was in the last picture is still in this one then, and what moves is felt late. It shows while
nothing moves, in the markers' noise: that of one picture has nothing to do with that of the next,
unless a share `a` of the next is the last. Differences of successive pictures then have, in place
of -1/2, the correlation -(1 - a) / 2 with the next ones. Motion is smooth over the sheet and noise
is not: a polynomial takes it out, and where it has taken out more than noise has, something moves.

Rounding to whole grey levels is noise of its own, which makes a large `a` look smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Markers

_DEGREE_MAX = 5
_MARKERS_TO_A_TERM = 3
_STILL = 1.5  # of the noise's mean square, which the polynomial may have taken out
_KEPT = 0.95  # of what was seen, from still picture to still picture: 20 of them count
_ENOUGH = 6.0  # still pictures, by weight
_SURE = 0.15  # of a share: three of its sd with 16 markers, ten with 81


@dataclass(frozen=True, eq=False)
class Blend:
    """What pictures up to the last one have told: places `p` (m, 3) m of the markers `ids` in it,
    by how much they had moved, `moved` (m, 3) in sd, without what is smooth (None: something
    moved), and sums over still pictures: of products of successive moves, of their squares, and of
    the pictures."""

    ids: NDArray[np.int64]
    p: Array
    moved: Array | None = None
    products: float = 0.0
    squares: float = 0.0
    count: float = 0.0

    @property
    def share(self) -> float:
        """Of the last picture in each; 0 where it is not known, or none for sure."""
        if self.count < _ENOUGH or self.squares <= 0:
            return 0.0
        share = 1 + 2 * self.products / self.squares
        return min(share, 0.95) if share > _SURE else 0.0

    @property
    def images(self) -> float:
        """By how many pictures what is seen lags behind."""
        return self.share / (1 - self.share)


class BlendEstimator:
    """Follows one sensor's pictures; nothing changes.

    Args:
        p_SM: All markers' places on the flat sheet, (N, 3) m.
    """

    def __init__(self, p_SM: Array):
        degree = _degree(len(p_SM))
        powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        x, y = (p_SM[:, :2] / np.abs(p_SM[:, :2]).max()).T
        self._terms = np.column_stack([x**i * y**j for i, j in powers])
        self._smooth = np.linalg.qr(self._terms)[0]

    def after(self, before: Blend | None, markers: Markers) -> Blend:
        """What is known after a picture with these markers.

        Args:
            before: After the last picture; None: there was none.
            markers: Seen in this one.

        Returns:
            The same after it. A picture with other markers than the last tells nothing.
        """
        seen = Blend(markers.ids, markers.p_SM)
        if before is None:
            return seen
        seen = replace(before, ids=markers.ids, p=markers.p_SM, moved=self._moved(before, markers))
        if seen.moved is None or before.moved is None or len(seen.moved) != len(before.moved):
            return seen
        squares = (np.square(seen.moved).sum() + np.square(before.moved).sum()) / 2
        return replace(
            seen,
            products=_KEPT * before.products + float((seen.moved * before.moved).sum()),
            squares=_KEPT * before.squares + float(squares),
            count=_KEPT * before.count + 1,
        )

    def _moved(self, before: Blend, markers: Markers) -> Array | None:
        """By how much the markers have moved since, (m, 3) in sd, without what is smooth; None
        where they are others, or really move."""
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
    """Of the polynomial: as high as so many markers carry."""
    for degree in range(_DEGREE_MAX, 0, -1):
        terms = (degree + 1) * (degree + 2) // 2
        if _MARKERS_TO_A_TERM * terms <= markers:
            return degree
    return 0
