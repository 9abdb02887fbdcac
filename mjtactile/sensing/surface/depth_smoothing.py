"""Depth of equal circles on a smooth surface, by a smoothing spline over neighbors.

The depth of a small circle depends on a few hundredths of a pixel of its size. The processing of a
consumer camera (demosaicing, sharpening, clipping) changes that size from circle to circle. This
change is far beyond the noise. Many equal circles on one smooth surface do determine the change of
depth between neighbors.

The prior is a thin-plate spline for the inverse depth over the image. The model is w_i = f(x_i) + s
sd_i e_i. The weight of its bending energy and s are both found by restricted maximum likelihood.
Bends that the markers support are kept. Deviations that appear independent from marker to marker
are treated as error. A plane's inverse depth is linear in the image, so that flat boards have no
bending energy. Neither flatness nor any spacing is assumed. The spline keeps at least one degree of
freedom for every `_PER_FREEDOM` circles. So a depth averages at most about as many circles.

This is a prior on the scene. It does not hold for circles at independent depths. It is rejected if
the scatter about the spline exceeds the possible error of a camera's processing. Touch sensing
never uses it, because its purpose is to measure a membrane's small bumps.

Wahba (1990), Spline Models for Observational Data, ch. 2 (spline), 4.8 (likelihood), 5 (posterior
variance).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, CirclePoses
from mjtactile.sensing.settings import DEFAULTS, SmoothnessSettings

# Half and twice these values had no visible effect on any image of `bench setting-sensitivity`.
_PER_FREEDOM = 8.0  # maximum number of circles per degree of freedom of the spline
_MAX_SCATTER = 5.0  # ratio to the predicted sd that a real camera may cause on a smooth surface
# minimum error, relative to the predicted sd: a noise-free bend can resemble noise
_MIN_SD_FRACTION = 0.7

_ROUNDS = 3
# tested signal-to-noise ratios, relative to the stiffest mode
_RATIOS = np.exp(np.arange(-18.0, 18.5, 0.75))


@dataclass(frozen=True)
class _Smooth:
    """`value` (N,) of the spline, its `sd` (N,), `weight` (N,) of each datum, `scatter` over
    predicted sd."""

    value: Array
    sd: Array
    weight: Array
    scatter: float


@dataclass(frozen=True, eq=False)
class SharedDepth:
    """Depths `z` m, with `sd` m, that the circles `at` (indices) agree on. `relative_sd`, m, is
    the part of `sd` that differs between circles."""

    at: NDArray[np.intp]
    z: Array
    sd: Array
    relative_sd: Array

    def relative_sds(self, count: int) -> Array:
        """Return `relative_sd` of all `count` circles; NaN for those off the surface."""
        sd = np.full(count, np.nan)
        sd[self.at] = self.relative_sd
        return sd

    def along_rays(self, poses: CirclePoses, cov_p_alt: Array) -> tuple[CirclePoses, Array]:
        """Return `poses` moved to these depths along their rays, and the moved covariance of the
        second centers, (N, 3, 3) m^2."""
        p = poses.p_CM.copy()
        alt = poses.p_CM_alt.copy()
        cov = poses.cov_p.copy()
        cov_alt = cov_p_alt.copy()
        scale = self.z / p[self.at, 2]
        for center, matrix in ((p, cov), (alt, cov_alt)):
            ray = center[self.at] / center[self.at, 2:]
            # an error e = z d(ray) + ray dz: the first part stays, scaled; dz is the spline's
            across = np.tile(np.eye(3), (len(ray), 1, 1))
            across[:, :, 2] -= ray
            at_circles = (
                across @ matrix[self.at] @ across.transpose(0, 2, 1) * (scale**2)[:, None, None]
            )
            matrix[self.at] = at_circles + np.einsum("n,ni,nj->nij", self.sd**2, ray, ray)
            center[self.at] *= scale[:, None]  # both solutions are equally far away
        return replace(poses, p_CM=p, p_CM_alt=alt, cov_p=cov), cov_alt


def agree_on_depth(
    alone: CirclePoses, s: SmoothnessSettings = DEFAULTS.smoothness
) -> SharedDepth | None:
    """Fit a smooth surface to the circles; None if they do not clearly lie on one. `alone` was
    estimated without neighbors, so errors are independent. Circles off the surface are not in
    `at`."""
    ok = np.flatnonzero(alone.status == "ok")
    if not s.circle_range[0] <= len(ok) <= s.circle_range[1]:
        return None
    z = alone.p_CM[ok, 2]
    sd = np.sqrt(alone.cov_p[ok, 2, 2]) / z**2
    smooth = _fit(alone.p_CM[ok, :2] / z[:, None], 1 / z, sd, s)
    agree = (smooth.weight > s.min_weight) & (smooth.value > 0)
    if smooth.scatter > _MAX_SCATTER or agree.mean() < s.min_agreeing_fraction:
        return None
    spread = np.hypot(smooth.sd, s.common_fraction * max(smooth.scatter, 1.0) * sd)
    per_inverse = 1 / smooth.value[agree] ** 2
    return SharedDepth(
        ok[agree],
        1 / smooth.value[agree],
        spread[agree] * per_inverse,
        smooth.sd[agree] * per_inverse,
    )


def _fit(xy: Array, w: Array, sd: Array, s: SmoothnessSettings) -> _Smooth:
    """Fit a robust thin-plate spline to `w` (N,) at `xy` (N, 2), with smoothness estimated from the
    data."""
    x = (xy - xy.mean(axis=0)) / max(float(np.ptp(xy, axis=0).max()), 1e-12)
    square = ((x[:, None] - x[None]) ** 2).sum(axis=2)
    K = 0.5 * square * np.log(square + 1e-300)
    T = np.column_stack([np.ones(len(x)), x])
    weight = _not_gross(x, w / sd, sd, s.gross_scatters)
    value = w
    spread = sd
    scatter = np.inf
    for _ in range(_ROUNDS):
        value, spread = _spline(K, T, w, sd / np.sqrt(weight), s)
        left = np.abs(w - value) / sd
        scatter = float(np.median(left) / 0.6745)  # of a normal distribution
        weight = 1 / (1 + (left / (s.outlier_scatters * max(scatter, 1e-9))) ** 4)
    return _Smooth(value, spread, np.maximum(weight, 1e-6), scatter)


def _not_gross(x: Array, y: Array, sd: Array, gross: float) -> Array:
    """Return initial weights (N,): least absolute deviations from a second-order surface reveal a
    circle of another size."""
    A = (
        np.column_stack([np.ones(len(x)), x, x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2])
        / sd[:, None]
    )
    weight = np.ones(len(x))
    left = y
    scale = 1.0
    for _ in range(15):
        root = np.sqrt(weight)
        left = np.abs(y - A @ np.linalg.lstsq(A * root[:, None], y * root, rcond=None)[0])
        scale = max(float(np.median(left)) / 0.6745, 1e-9)
        weight = 1 / np.maximum(left / scale, 0.1)
    return np.maximum(1 / (1 + (left / (gross * scale)) ** 4), 1e-6)


def _spline(K: Array, T: Array, w: Array, sd: Array, s: SmoothnessSettings) -> tuple[Array, Array]:
    """Return the spline's values (N,) and posterior standard deviations (N,), by the eigenvectors V
    of the bending energy beyond planes."""
    n = len(w)
    beyond = np.linalg.qr(T / sd[:, None], mode="complete")[0][:, 3:]
    k, U = np.linalg.eigh(beyond.T @ (K / np.outer(sd, sd)) @ beyond)
    k = np.maximum(k, 0.0)
    V = beyond @ U
    z2 = (V.T @ (w / sd)) ** 2
    gain = 1 + np.outer(_RATIOS / max(k[-1], 1e-300), k)  # (ratios, n - 3)
    freedom = n - (1 / gain).sum(axis=1)
    left = (z2 / gain).mean(axis=1)
    variance = np.maximum(left, _MIN_SD_FRACTION**2)
    minus_log = np.log(gain).sum(axis=1) + (n - 3) * (np.log(variance) + left / variance)
    minus_log[freedom < n / _PER_FREEDOM] = np.inf
    best = int(np.argmin(minus_log))
    shrink = 1 / gain[best]
    value = w - sd * (V @ (shrink * (V.T @ (w / sd))))
    return value, sd * np.sqrt(variance[best] * np.maximum(1 - (V * V) @ shrink, 1e-12))
