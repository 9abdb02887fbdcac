"""The reference for mjtactile/kernels/marker_matching.c: matching circles to markers in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.types import Array
from mjtactile.sensing.pose.marker_matching import Ids, _neighbourhood
from mjtactile.sensing.settings import DEFAULTS, IdentitySettings

_ROUNDS = 3  # match, learn how the neighbourhood moved, match again


def match(
    p_SM: ArrayLike, expected: ArrayLike, layout: ArrayLike, s: IdentitySettings = DEFAULTS.identity
) -> Ids:
    """Return marker ids (N,) of circles at `p_SM` (N, 3) m, -1 for circles without a match.

    `expected` (M, 3) m are predicted positions (NaN: unknown, then from the neighbours). `layout`
    (M, 3) m is the flat membrane's layout, which defines the neighbours. No id is assigned twice.
    NaN rows of `p_SM` have no match.
    """
    found = np.asarray(p_SM, dtype=float)[:, :2]
    layout = np.asarray(layout, dtype=float)[:, :2]
    expected = np.asarray(expected, dtype=float)[:, :2]
    pitch, order = _neighbourhood(layout.tobytes(), s.neighbours)
    known = np.isfinite(expected.sum(axis=1))
    expected = np.where(
        known[:, None],
        expected,
        layout + _smooth(np.where(known[:, None], expected - layout, np.nan), order, s),
    )
    ids = np.full(len(found), -1)
    if not np.isfinite(found.sum(axis=1)).any():
        return ids
    # all found where they are expected, and none left over, needs no common offset: a whole grid
    # cannot hide a shift
    shift = np.zeros(2)
    for tried in range(_ROUNDS + 1):
        if tried == 1:
            shift = _common_shift(found, expected, pitch, s)
        ids = _mutual_nearest(found, expected + shift, s.gate * pitch)
        moved = np.full_like(layout, np.nan)
        moved[ids[ids >= 0]] = found[ids >= 0] - expected[ids[ids >= 0]]
        common = _smooth(moved, order, s)
        wrong = np.linalg.norm(moved - common, axis=1) > s.displacement_tolerance * pitch
        ids[(ids >= 0) & wrong[ids]] = -1
        matched = (ids >= 0).sum()
        if not wrong.any() and matched == (
            min(len(found), len(layout)) if tried else max(len(found), len(layout))
        ):
            break
        moved[wrong] = np.nan
        shift = _smooth(moved, order, s)
    return ids


def _smooth(moved: Array, order: Ids, s: IdentitySettings) -> Array:
    """Return the median displacement (M, 2) of each marker's nearest `neighbours` with a known one
    in `moved` (NaN: unknown).

    Without known neighbours it is the median of all; without any known displacement it is zero.
    """
    near = moved[order[:, : s.neighbours]]
    if np.isfinite(near.sum()):
        ranked = np.sort(near, axis=1)
        k = near.shape[1]
        return (ranked[:, (k - 1) // 2] + ranked[:, k // 2]) / 2
    near = moved[order]
    known = np.isfinite(near[..., 0])
    first = known & (np.cumsum(known, axis=1) <= s.neighbours)
    count = first.sum(axis=1)
    ranked = np.sort(np.where(first[..., None], near, np.inf), axis=1)
    each = np.arange(len(moved))
    low = ranked[each, np.maximum(count - 1, 0) // 2]
    high = ranked[each, count // 2 % near.shape[1]]
    everyone = moved[np.isfinite(moved[:, 0])]
    common = np.median(everyone, axis=0) if len(everyone) else np.zeros(2)
    with np.errstate(invalid="ignore"):
        return np.where(count[:, None] > 0, (low + high) / 2, common)


def _common_shift(found: Array, expected: Array, pitch: float, s: IdentitySettings) -> Array:
    """Return the offset (2,) of all circles from their expected positions, up to half a pitch.

    It is the densest point among the offsets of every circle to its nearest marker.
    """
    found = found[np.isfinite(found).all(axis=1)]
    offset = found - expected[np.argmin(_squared_distances(found, expected), axis=1)]
    offset = offset[(offset**2).sum(axis=1) < pitch * pitch]
    if not len(offset):
        return np.zeros(2)
    near = _squared_distances(offset, offset) < (pitch / s.shift_resolution) ** 2
    return np.median(offset[near[np.argmax(near.sum(axis=1))]], axis=0)


def _mutual_nearest(found: Array, expected: Array, gate: float) -> Ids:
    """Return mutual nearest neighbours closer than `gate`: ids (N,), -1 for none."""
    d2 = np.nan_to_num(_squared_distances(found, expected), nan=np.inf)
    ids = np.argmin(d2, axis=1)
    back = np.argmin(d2, axis=0)
    each = np.arange(len(found))
    return np.where((back[ids] == each) & (d2[each, ids] < gate * gate), ids, -1)


def _squared_distances(a: Array, b: Array) -> Array:
    """Return squares (N, M) of the distances of points (N, 2) and (M, 2)."""
    return np.subtract.outer(a[:, 0], b[:, 0]) ** 2 + np.subtract.outer(a[:, 1], b[:, 1]) ** 2
