"""Which detected circle is which marker, and which of its two normals is the right one.

Matching is by lateral position in S: markers keep a pitch from each other, while depth changes fast under a press.
At start-up the expected positions are those of the flat membrane, from which a common offset (a camera mounted a
little off) is taken out first; in a sequence they are those of the image before. Wrong matches are found because a
membrane moves together: a marker's displacement is compared with the median of its neighbours'.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from mjtactile.core import geometry, optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, CirclePoses, Markers
from mjtactile.sensing.settings import DEFAULTS, IdentitySettings
from mjtactile.sensing.shape.surface import SurfaceFitter

Ids = NDArray[np.int64]

_ROUNDS = 3  # match, learn how the neighbourhood moved, match again


def identify(poses: CirclePoses, design: SensorDesign, expected: ArrayLike | None = None,
             scale: ArrayLike | None = None, s: IdentitySettings = DEFAULTS.identity) -> Markers:
    """Identified markers in S from circle poses in C.

    `expected` (M, 3) m are the positions in S to look near, by default those of the flat membrane; `scale` (M,) is
    each marker's true radius over the nominal one that the poses were computed with, to which its apparent depth is
    proportional. Circles whose status is not "ok", that match no marker or do not move with their neighbours are left
    out. Of the two poses of a circle the one is kept whose normal fits the surface through all centres.
    """
    layout = design.markers.p_SM
    p_SM = poses.p_CM + design.camera.p_SC
    p_SM[poses.status != "ok"] = np.nan
    ids = match(p_SM, layout if expected is None else expected, layout, s)
    seen = np.flatnonzero(ids >= 0)
    seen = seen[np.argsort(ids[seen])]
    ids = ids[seen]
    factor = np.ones(len(ids)) if scale is None else np.asarray(scale, dtype=float)[ids]
    shift = _pane_shift(design, poses.p_CM[seen]) if (factor != 1).any() else 0.0
    # a circle `factor` times larger than assumed is as much farther from where its rays meet
    p, p_alt = ((p_CM[seen] - shift) * factor[:, None] + shift + design.camera.p_SC
                for p_CM in (poses.p_CM, poses.p_CM_alt))
    n, n_alt = poses.n_C[seen], poses.n_C_alt[seen]
    second = prefer_second(n, n_alt, expected_normals(design, ids, p[:, 2], s))
    return Markers(ids, np.where(second[:, None], p_alt, p), np.where(second[:, None], n_alt, n),
                   poses.cov_p[seen] * (factor**2)[:, None, None])


def match(p_SM: ArrayLike, expected: ArrayLike, layout: ArrayLike, s: IdentitySettings = DEFAULTS.identity) -> Ids:
    """Marker ids (N,) of circles at `p_SM` (N, 3) m, -1 where there is none.

    `expected` (M, 3) m positions to look near (NaN: unknown, then from its neighbours), `layout` (M, 3) m the flat
    membrane's, which says who is whose neighbour. No id is given twice. NaN rows of `p_SM` match nothing.
    """
    found = np.asarray(p_SM, dtype=float)[:, :2]
    layout = np.asarray(layout, dtype=float)[:, :2]
    expected = np.asarray(expected, dtype=float)[:, :2]
    pitch, order = _neighbourhood(layout.tobytes(), s.neighbours)
    known = np.isfinite(expected.sum(axis=1))
    expected = expected if known.all() else layout + _smooth(np.where(known[:, None], expected - layout, np.nan), order, s)
    ids = np.full(len(found), -1)
    if not np.isfinite(found.sum(axis=1)).any():
        return ids
    # all found where they are expected, and none left over, needs no common offset: a whole grid cannot hide a shift
    shift = np.zeros(2)
    for tried in range(_ROUNDS + 1):
        if tried == 1:
            shift = _common_shift(found, expected, pitch, s)
        ids = _mutual_nearest(found, expected + shift, s.gate * pitch)
        moved = np.full_like(layout, np.nan)
        moved[ids[ids >= 0]] = found[ids >= 0] - expected[ids[ids >= 0]]
        common = _smooth(moved, order, s)
        wrong = np.linalg.norm(moved - common, axis=1) > s.inconsistent * pitch
        ids[(ids >= 0) & wrong[ids]] = -1
        matched = (ids >= 0).sum()
        if not wrong.any() and matched == (min(len(found), len(layout)) if tried else max(len(found), len(layout))):
            break
        moved[wrong] = np.nan
        shift = _smooth(moved, order, s)
    return ids


def prefer_second(n: Array, n_alt: Array, n_expected: Array) -> NDArray[np.bool_]:
    """Where (N,) the second of two unit normals (N, 3) is nearer to the expected one."""
    return ((n_alt - n) * n_expected).sum(axis=1) > 0


def expected_normals(design: SensorDesign, ids: Ids, z: ArrayLike, s: IdentitySettings = DEFAULTS.identity) -> Array:
    """Normals (N, 3) towards the camera, at markers `ids` (N,), of the smooth surface through their heights `z` (N,) m.

    The surface is a function of the *flat* membrane's coordinates, so that its design matrix is always the same; the
    lateral stretch that this neglects changes a slope's size, not its direction.
    """
    present = np.zeros(design.markers.count, bool)
    present[ids] = True
    slope_x, slope_y = _slope_operators(design, present.tobytes(), s.height_weight)
    z = np.asarray(z, dtype=float)
    order = np.argsort(ids)
    slopes = np.empty((len(z), 2))
    slopes[order] = np.column_stack([slope_x @ z[order], slope_y @ z[order]])
    return geometry.normal_from_slope(slopes[:, 0], slopes[:, 1])


@lru_cache(maxsize=32)
def _slope_operators(design: SensorDesign, present: bytes, weight: float) -> tuple[Array, Array]:
    """Matrices that make slopes at the markers present, in order of id, of their heights, which are known to `weight` 1/m^2."""
    fitter = SurfaceFitter(design)
    x, y = design.markers.p_SM[np.frombuffer(present, bool), :2].T
    B = fitter.rows(x, y)
    gain = cho_solve(cho_factor(B.T @ B * weight + fitter.prior), B.T * weight)
    return fitter.rows(x, y, 1, 0) @ gain, fitter.rows(x, y, 0, 1) @ gain


@lru_cache(maxsize=8)
def _neighbourhood(layout: bytes, neighbours: int) -> tuple[float, Ids]:
    """Smallest distance of two markers, m, and each one's nearest markers (M, k), itself not among them."""
    xy = np.frombuffer(layout).reshape(-1, 2)
    distance = np.linalg.norm(xy[:, None] - xy, axis=2)
    np.fill_diagonal(distance, np.inf)
    order = np.argsort(distance, axis=1, kind="stable")
    return float(distance.min()), order[:, : min(3 * neighbours, len(xy) - 1)]


def _smooth(moved: Array, order: Ids, s: IdentitySettings) -> Array:
    """Median displacement (M, 2) of each marker's nearest `neighbours` with a known one (NaN: unknown) in `moved`.

    Where there are none, the median of all; zero if nothing is known.
    """
    near = moved[order[:, :s.neighbours]]
    if np.isfinite(near.sum()):
        ranked, k = np.sort(near, axis=1), near.shape[1]
        return (ranked[:, (k - 1) // 2] + ranked[:, k // 2]) / 2
    near = moved[order]
    known = np.isfinite(near[..., 0])
    first = known & (np.cumsum(known, axis=1) <= s.neighbours)
    count = first.sum(axis=1)
    ranked = np.sort(np.where(first[..., None], near, np.inf), axis=1)
    each = np.arange(len(moved))
    low, high = ranked[each, np.maximum(count - 1, 0) // 2], ranked[each, count // 2 % near.shape[1]]
    everyone = moved[np.isfinite(moved[:, 0])]
    common = np.median(everyone, axis=0) if len(everyone) else np.zeros(2)
    with np.errstate(invalid="ignore"):
        return np.where(count[:, None] > 0, (low + high) / 2, common)


def _common_shift(found: Array, expected: Array, pitch: float, s: IdentitySettings) -> Array:
    """Offset (2,) of all circles against where they are expected, up to half a pitch: the densest place among the
    offsets of every circle to its nearest marker."""
    found = found[np.isfinite(found).all(axis=1)]
    offset = found - expected[np.argmin(_squared_distances(found, expected), axis=1)]
    offset = offset[(offset**2).sum(axis=1) < pitch * pitch]
    if not len(offset):
        return np.zeros(2)
    near = _squared_distances(offset, offset) < (pitch / s.same_shift) ** 2
    return np.median(offset[near[np.argmax(near.sum(axis=1))]], axis=0)


def _mutual_nearest(found: Array, expected: Array, gate: float) -> Ids:
    """Pairs that are each other's nearest and closer than `gate`: ids (N,), -1 for none."""
    d2 = np.nan_to_num(_squared_distances(found, expected), nan=np.inf)
    ids = np.argmin(d2, axis=1)
    back = np.argmin(d2, axis=0)
    each = np.arange(len(found))
    return np.where((back[ids] == each) & (d2[each, ids] < gate * gate), ids, -1)


def _pane_shift(design: SensorDesign, p_CM: Array) -> Array:
    """Displacement (N, 3) m by the pane of points `p_CM` (N, 3)."""
    camera = optics.Camera.from_design(design.camera, design.glass)
    ray = np.concatenate([optics.refract(camera, p_CM), np.ones((len(p_CM), 1))], axis=1)
    return optics.glass_shift(camera, ray)[:, None] * [0.0, 0.0, 1.0]


def _squared_distances(a: Array, b: Array) -> Array:
    """Squares (N, M) of the distances of points (N, 2) and (M, 2)."""
    return np.subtract.outer(a[:, 0], b[:, 0]) ** 2 + np.subtract.outer(a[:, 1], b[:, 1]) ** 2
