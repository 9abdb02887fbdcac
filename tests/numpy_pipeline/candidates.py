"""The reference for mjtactile/kernels/candidates.c: moments of borders, and the judgement of
candidates and fits, in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mjtactile.core.types import Array
from mjtactile.sensing.image import candidates, edge_fit, ellipse
from mjtactile.sensing.image.candidates import Candidates
from mjtactile.sensing.image.fit_validation import (
    BLURRED,
    CUT,
    GLARE,
    LONG,
    LOW_CONTRAST,
    MOTION,
    MOVED,
    NO_FIT,
    NOT_ELLIPSE,
    SMALL,
    TOUCHING,
)
from mjtactile.sensing.settings import MarkerSettings

_DIVISORS = np.array([[2.0], [6.0], [6.0], [12.0], [24.0], [12.0]])  # of the polygon's moments


def moments(
    points: NDArray[np.int32], counts: NDArray[np.int64], size: tuple[int, ...]
) -> Candidates:
    """Return area moments of all borders at once, by Green's theorem on the polygons through their
    pixels' centres.

    `points` (P, 1, 2) of one border after the other, `counts` (N,) of them.
    """
    ends = counts.cumsum() - 1
    starts = ends - counts + 1
    xy = points[:, 0].T.astype(float)
    following = np.empty_like(xy)
    following[:, :-1] = xy[:, 1:]
    following[:, ends] = xy[:, starts]
    (x, y), (x2, y2) = xy, following
    sx = x + x2
    sy = y + y2
    terms = np.empty((6, len(x)))
    cross = np.subtract(x * y2, x2 * y, out=terms[0])
    terms[1] = cross * sx
    terms[2] = cross * sy
    terms[3] = cross * (sx * sx - x * x2)
    terms[5] = cross * (sy * sy - y * y2)
    terms[4] = cross * (sx * sy + x * y + x2 * y2)
    area, mx, my, mxx, mxy, myy = np.add.reduceat(terms, starts, axis=1) / _DIVISORS
    # A one-pixel-wide border has no area; it is no marker either, so that any non-zero stand-in
    # will do.
    flat = np.abs(area) < 0.5
    area[flat] = 1.0
    cx = mx / area
    cy = my / area
    second = np.array([mxx / area - cx * cx, mxy / area - cx * cy, myy / area - cy * cy]).T
    second[flat] = [0.01, 0.0, 0.01]
    shape = ellipse.shape_from_moments(second)
    # The polygon runs through centres of boundary pixels, half a pixel inside of the blob's
    # outline.
    shape += [0.5, 0.0, 0.5]
    center = np.array([cx, cy]).T
    misfit = np.maximum.reduceat(_distance(xy, center, shape, counts), starts)
    misfit[flat] = np.inf
    room = np.minimum(np.minimum(x, y), np.minimum(size[1] - 1 - x, size[0] - 1 - y))
    return Candidates(center, shape, misfit, np.minimum.reduceat(room, starts) <= 0)


def _distance(xy: Array, center: Array, shape: Array, counts: NDArray[np.int64]) -> Array:
    """Compute the first-order distance |(rho - 1)/|S^-1 e|| (P,) of border points `xy` (2, P) from
    their ellipses. The blob's outline is half a pixel outside these points."""
    own = np.concatenate([center.T, ellipse.inverse_shape(shape).T]).repeat(counts, axis=1)
    dx, dy = xy - own[:2]
    p, q, s = own[2:]
    ex = p * dx + q * dy
    ey = q * dx + s * dy
    rho2 = ex * ex + ey * ey
    mx = p * ex + q * ey
    my = q * ex + s * ey
    return np.abs((rho2 - np.sqrt(rho2)) / np.sqrt(mx * mx + my * my + 1e-18) + 0.5)


def implausible(
    found: candidates.Candidates, min_radius_px: float, s: MarkerSettings
) -> NDArray[np.str_]:
    """Return the reason why each fit is not a marker: too small or long, or a border far from its
    ellipse (with a larger limit if cut); "" for a marker."""
    axes, _ = ellipse.axes_from_shape(found.shape)
    a, b = axes.T
    reason = np.full(len(a), "", dtype="<U24")
    reason[_odd(found, s)] = NOT_ELLIPSE
    reason[b <= s.min_border_axes * a] = LONG
    reason[b < min_radius_px] = SMALL
    fits = reason == ""
    if fits.sum() >= s.min_peers:
        # a border as large as the others' but of another outline is a marker with glare or dirt on
        # it, to be flagged
        size = np.sqrt(a * b)
        alike = np.abs(np.log(size / ellipse.upper_median(size[fits]))) < s.size_log_tolerance
        reason[
            alike & (b > s.min_flawed_axes * a) & (found.misfit < s.max_flawed_misfit * size)
        ] = ""
    return reason


def _odd(found: candidates.Candidates, s: MarkerSettings) -> NDArray[np.bool_]:
    """Return True for borders far from their own ellipses; cut borders have a larger tolerance."""
    b = ellipse.axes_from_shape(found.shape)[0][:, 1]
    return (
        found.misfit
        >= s.max_border_misfit
        + np.where(found.cut, s.border_misfit_fraction_cut, s.border_misfit_fraction) * b
    )


def validate_fits(
    fit: edge_fit.EdgeFit,
    found: candidates.Candidates,
    polarity: str,
    size: tuple[int, ...],
    min_radius_px: float,
    s: MarkerSettings,
) -> tuple[NDArray[np.str_], NDArray[np.bool_]]:
    """Return the status (N,) of each fit, and True (N,) if it is likely a marker, trusted or
    not."""
    axes, _ = ellipse.axes_from_shape(fit.shape)
    a, b = axes.T
    contrast = (fit.outside - fit.inside) * (1 if polarity == "dark" else -1)
    noise = np.maximum(fit.residual, 1e-3)
    shape_sd = np.sqrt(fit.cov[:, 2, 2] + fit.cov[:, 3, 3] + fit.cov[:, 4, 4]) / b
    moved = np.hypot(*(fit.center - found.center).T)
    extent = np.hypot(fit.shape[:, [0, 2]], fit.shape[:, 1:2])
    out = (
        (fit.center - extent < s.min_edge_distance)
        | (fit.center + extent > np.array([size[1], size[0]]) - 1 - s.min_edge_distance)
    ).any(axis=1)
    status = np.full(len(b), "ok", dtype="<U24")
    status[(contrast < s.min_contrast * noise) | (shape_sd > s.max_shape_sd)] = LOW_CONTRAST
    status[fit.residual > s.max_residual * contrast] = NOT_ELLIPSE
    # of this image: its noise, its compression
    usual = ellipse.upper_median(fit.residual) if len(b) else 0.0
    covered = (
        fit.residual > np.maximum(s.covered_fraction * contrast, s.covered_residuals * usual)
    ) & (b > s.profile_min_radius)
    status[(fit.lost > s.max_lost_weight) | covered] = GLARE
    status[fit.motion > s.min_motion] = MOTION
    # blur is the image's, and its scatter from marker to marker mostly the fit's
    common = ellipse.upper_median(fit.blur[good]) if (good := status == "ok").any() else 0.0
    status[b < s.min_blurs * np.clip(fit.blur, common / s.blur_spread, common * s.blur_spread)] = (
        BLURRED
    )
    took_blur_for_size = (fit.blur < s.sharper_ratio * common) & (common > 1)
    status[took_blur_for_size & (b < s.sure_blurs * common)] = BLURRED
    changed = np.abs(fit.shape - found.shape).max(axis=1)
    status[changed > s.max_border_misfit + s.max_shape_change * b] = NOT_ELLIPSE
    status[b < min_radius_px] = SMALL
    cut = out | found.cut
    status[cut] = CUT
    odd = _odd(found, s) & ~cut
    status[odd] = GLARE
    drop = np.zeros(len(b), dtype=bool)
    for rejected, reason in (
        ((moved > 1 + s.max_move * b) & ~cut & ~odd, MOVED),
        ((contrast < s.min_contrast_any * noise), LOW_CONTRAST),
        ((shape_sd > s.max_shape_sd_any) | (fit.residual >= edge_fit.UNSETTLED), NO_FIT),
        (b < s.min_fit_axes * a, LONG),
        (b < s.shrunk_fraction * min_radius_px, SMALL),
    ):
        drop |= rejected
        status[rejected] = reason
    good = np.flatnonzero(status == "ok")
    status[good[_crowded(fit.center[good], fit.shape[good], a[good], s.min_edge_distance)]] = (
        TOUCHING
    )
    return status, ~drop


def _crowded(center: Array, shape: Array, a: Array, close: float) -> NDArray[np.bool_]:
    """Return True (N,) for ellipses within `close` px of another's edge, measured along the line of
    centers."""
    if len(center) < 2:
        return np.zeros(len(center), dtype=bool)
    near = KDTree(center).query_pairs(2 * a.max() + close, output_type="ndarray")
    near = near[
        np.square(np.diff(center[near], axis=1)).sum(axis=(1, 2))
        < np.square(a[near].sum(axis=1) + close)
    ]
    if not len(near):
        return np.zeros(len(center), dtype=bool)
    i, j = near.T
    d = center[j] - center[i]
    length = np.maximum(np.hypot(*d.T), 1e-9)
    towards = d / length[:, None]
    span = 0.0
    for k in (i, j):
        p, q, s = ellipse.inverse_shape(shape[k]).T
        span = span + 1 / np.hypot(
            p * towards[:, 0] + q * towards[:, 1], q * towards[:, 0] + s * towards[:, 1]
        )
    touching = near[length < span + close]
    crowded = np.zeros(len(center), dtype=bool)
    crowded[touching.ravel()] = True
    return crowded
