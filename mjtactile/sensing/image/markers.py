"""From an image to ellipses with covariance and status: candidates, sub-pixel fit, and the judgement of each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array, Ellipses, Image
from mjtactile.sensing.image import candidates, edges, ellipse, profiles
from mjtactile.sensing.settings import DEFAULTS, MarkerSettings, Settings

Polarity = Literal["dark", "bright"]
CUT, NOT_ELLIPSE, TOUCHING = "cut by image border", "not an ellipse", "touches another"
LOW_CONTRAST, GLARE, SMALL = "low contrast", "glare or dirt", "too small"
MOTION, BLURRED = "motion blur", "too blurred"
LONG, NO_FIT, MOVED = "too long", "no fit", "edge lies elsewhere"


def detect(image: NDArray | Image, camera: Any = None, *, polarity: Polarity = "dark",
           min_radius_px: float = 1.5, settings: Settings = DEFAULTS) -> Ellipses:
    """Find circular markers in `image` ((H, W) or (H, W, 3) uint8 or uint16, or an `Image`).

    `polarity`: markers "dark" on bright or "bright" on dark. `camera` is accepted so that all stages look alike;
    ellipses are in distorted pixels, as in the image. `min_radius_px`: smallest semi-minor axis looked for; from 4
    px on, the search runs at half the resolution (the fit does not).

    Returns `Ellipses` in reading order of detection; those whose status is not "ok" are likely markers that should not
    be trusted. No marker gives an empty result. Raises InputError for a wrong shape, type or option.
    """
    grey, s = grey_image(image), settings.markers
    check_polarity(polarity)
    eight = eight_bit(grey)
    found = candidates.find(eight if polarity == "dark" else 255 - eight, min_radius_px, settings.candidates)
    found = found.take(implausible(found, min_radius_px, s) == "")
    fit = fit_candidates(grey, found, settings)
    status, keep = judge(fit, found, polarity, grey.shape, min_radius_px, s)
    if not keep.all():
        fit, status = fit.take(keep), status[keep]
    return as_ellipses(fit, status)


def check_polarity(polarity: str) -> None:
    """Raises InputError for another than those that there are."""
    if polarity not in ("dark", "bright"):
        raise InputError(f"{polarity!r}", source="detect", field="polarity", choices=("dark", "bright"))


def as_ellipses(fit: edges.EdgeFit, status: NDArray[np.str_]) -> Ellipses:
    """Fits as semi-axes and angles."""
    axes, angle = ellipse.axes_from_shape(fit.shape)
    return Ellipses(fit.center, axes, angle, ellipse.covariance_of_axes(fit.cov, axes, angle), status)


def grey_image(image: NDArray | Image) -> NDArray:
    """The grey channel (H, W), uint8 or uint16, of an array or `Image`; colour by the mean of its channels."""
    pixels = np.asarray(image.pixels if isinstance(image, Image) else image)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{pixels.dtype} pixels", source="image", field="dtype", choices=("uint8", "uint16"))
    if pixels.ndim == 3 and pixels.shape[2] in (1, 3, 4):
        colour = pixels[..., :3]
        pixels = np.rint(colour.mean(axis=2)).astype(pixels.dtype) if pixels.shape[2] > 1 else pixels[..., 0]
    if pixels.ndim != 2 or min(pixels.shape) < 8:
        raise InputError(f"shape {pixels.shape} is not an image of at least 8 x 8 pixels", source="image",
                         field="shape", choices=("(H, W)", "(H, W, 3)"))
    return np.ascontiguousarray(pixels)


def fit_candidates(grey: NDArray, found: candidates.Candidates, settings: Settings) -> edges.EdgeFit:
    """An ellipse for each candidate, with a covariance that can be believed or is as large as the marker."""
    return sound(_fit(grey, found, settings))


def _fit(grey: NDArray, found: candidates.Candidates, settings: Settings) -> edges.EdgeFit:
    """Profiles for what is large enough; the image itself, which costs ten times more per pixel, for the small."""
    s, by_pixels = settings.markers, settings.edges
    axes, _ = ellipse.axes_from_shape(found.shape)
    large = axes[:, 1] >= s.room
    if not large.any():
        return edges.fit(grey, found.center, found.shape, s=by_pixels)
    fit = profiles.fit(grey, found.center[large], found.shape[large], settings.profiles)
    blurred = (fit.blur * s.blurred > axes[large, 1]) & (fit.motion < s.motion)  # `edges` knows of no motion
    sharpest = fit.blur < 1.01 * settings.profiles.sharpest  # a drawing, or a blur that was taken for size
    if sharpest.any():
        start = found.take(large).take(sharpest)
        wide = s.wide * float(ellipse.middle(axes[large, 1][sharpest]))
        again = edges.fit(grey, start.center, start.shape, blur=wide, s=by_pixels)
        settled = again.residual < edges.UNSETTLED
        sharpest[sharpest] = settled
        fit = edges.merge(sharpest, again.take(settled), fit.take(~sharpest))
        blurred &= ~sharpest
    if blurred.any():
        common = float(np.median(fit.blur[blurred]))
        again = edges.fit(grey, fit.center[blurred], fit.shape[blurred], blur=common, s=by_pixels)
        fit = edges.merge(blurred, again, fit.take(~blurred))
    if large.all():
        return fit
    others = found.center[large], found.shape[large]
    return edges.merge(large, fit, edges.fit(grey, found.center[~large], found.shape[~large], others=others, s=by_pixels))


def sound(fit: edges.EdgeFit) -> edges.EdgeFit:
    """`fit` with a covariance as large as the marker, and no trust, where the numbers are not those of a minimum."""
    variances = np.diagonal(fit.cov, axis1=1, axis2=2)
    bad = ~(np.isfinite(fit.cov.sum(axis=(1, 2)) + fit.residual) & (variances.min(axis=1, initial=np.inf) > 0))
    if not bad.any():
        return fit
    size = np.square(fit.shape[bad]).sum(axis=1)
    cov, residual = fit.cov.copy(), fit.residual.copy()
    cov[bad], residual[bad] = np.eye(5) * size[:, None, None], 1e9
    return replace(fit, cov=cov, residual=residual)


def eight_bit(grey: NDArray) -> NDArray[np.uint8]:
    """Candidates need contrast, not depth: stretch what is really used of 16 bits to 8."""
    if grey.dtype == np.uint8:
        return grey
    low, high = np.percentile(grey[::4, ::4], [0.1, 99.9])
    return np.clip((grey - low) * (255 / max(high - low, 1.0)), 0, 255).astype(np.uint8)


def implausible(found: candidates.Candidates, min_radius_px: float, s: MarkerSettings) -> NDArray[np.str_]:
    """Why each cannot be a marker: too small or long, or a border far from its own ellipse (further if cut); "" if it can."""
    axes, _ = ellipse.axes_from_shape(found.shape)
    a, b = axes.T
    why = np.full(len(a), "", dtype="<U24")
    why[_odd(found, s)] = NOT_ELLIPSE
    why[b <= s.longest * a] = LONG
    why[b < min_radius_px] = SMALL
    fits = why == ""
    if fits.sum() >= s.some:
        # a border as large as the others' but of another outline is a marker with glare or dirt on it, to be flagged
        size = np.sqrt(a * b)
        alike = np.abs(np.log(size / ellipse.middle(size[fits]))) < s.alike
        why[alike & (b > s.longest_flawed * a) & (found.misfit < s.flawed * size)] = ""
    return why


def _odd(found: candidates.Candidates, s: MarkerSettings) -> NDArray[np.bool_]:
    """Which borders are far from their own ellipses (further if cut)."""
    b = ellipse.axes_from_shape(found.shape)[0][:, 1]
    return found.misfit >= s.odd + np.where(found.cut, s.odd_share_cut, s.odd_share) * b


def judge(fit: edges.EdgeFit, found: candidates.Candidates, polarity: str, size: tuple[int, ...],
          min_radius_px: float, s: MarkerSettings) -> tuple[NDArray[np.str_], NDArray[np.bool_]]:
    """Status (N,) of each fit, and whether (N,) it is likely a marker at all, be it to be trusted or not."""
    axes, _ = ellipse.axes_from_shape(fit.shape)
    a, b = axes.T
    contrast = (fit.outside - fit.inside) * (1 if polarity == "dark" else -1)
    noise = np.maximum(fit.residual, 1e-3)
    doubt = np.sqrt(fit.cov[:, 2, 2] + fit.cov[:, 3, 3] + fit.cov[:, 4, 4]) / b
    moved = np.hypot(*(fit.center - found.center).T)
    extent = np.hypot(fit.shape[:, [0, 2]], fit.shape[:, 1:2])
    out = ((fit.center - extent < s.close) | (fit.center + extent > np.array([size[1], size[0]]) - 1 - s.close)).any(axis=1)
    status = np.full(len(b), "ok", dtype="<U24")
    status[(contrast < s.contrast * noise) | (doubt > s.doubt)] = LOW_CONTRAST
    status[fit.residual > s.misfit * contrast] = NOT_ELLIPSE
    usual = ellipse.middle(fit.residual) if len(b) else 0.0  # of this image: its noise, its compression
    covered = (fit.residual > np.maximum(s.covered * contrast, s.covered_usual * usual)) & (b > s.room)
    status[(fit.lost > s.lost) | covered] = GLARE
    status[fit.motion > s.motion] = MOTION
    # blur is the image's, and its scatter from marker to marker mostly the fit's
    common = ellipse.middle(fit.blur[good]) if (good := status == "ok").any() else 0.0
    status[b < s.too_blurred * np.clip(fit.blur, common / s.blur_spread, common * s.blur_spread)] = BLURRED
    took_blur_for_size = (fit.blur < s.sharper * common) & (common > 1)
    status[took_blur_for_size & (b < s.unsure * common)] = BLURRED
    changed = np.abs(fit.shape - found.shape).max(axis=1)
    status[changed > s.odd + s.changed * b] = NOT_ELLIPSE
    status[b < min_radius_px] = SMALL
    cut = out | found.cut
    status[cut] = CUT
    odd = _odd(found, s) & ~cut
    status[odd] = GLARE
    drop = np.zeros(len(b), dtype=bool)
    for what, why in (((moved > 1 + s.moved * b) & ~cut & ~odd, MOVED), ((contrast < s.contrast_any * noise), LOW_CONTRAST),
                      ((doubt > s.doubt_any) | (fit.residual >= edges.UNSETTLED), NO_FIT),
                      (b < s.flattest * a, LONG), (b < s.shrunk * min_radius_px, SMALL)):
        drop |= what
        status[what] = why
    good = np.flatnonzero(status == "ok")
    status[good[_crowded(fit.center[good], fit.shape[good], a[good], s.close)]] = TOUCHING
    return status, ~drop


def _crowded(center: Array, shape: Array, a: Array, close: float) -> NDArray[np.bool_]:
    """Which ellipses (N,) come within `close` px of another's edge, measured along the line of centres."""
    if len(center) < 2:
        return np.zeros(len(center), dtype=bool)
    near = KDTree(center).query_pairs(2 * a.max() + close, output_type="ndarray")
    near = near[np.square(np.diff(center[near], axis=1)).sum(axis=(1, 2)) < np.square(a[near].sum(axis=1) + close)]
    if not len(near):
        return np.zeros(len(center), dtype=bool)
    i, j = near.T
    d = center[j] - center[i]
    length = np.maximum(np.hypot(*d.T), 1e-9)
    towards = d / length[:, None]
    reach = 0.0
    for k in (i, j):
        p, q, s = ellipse.inverse_shape(shape[k]).T
        reach = reach + 1 / np.hypot(p * towards[:, 0] + q * towards[:, 1], q * towards[:, 0] + s * towards[:, 1])
    touching = near[length < reach + close]
    crowded = np.zeros(len(center), dtype=bool)
    crowded[touching.ravel()] = True
    return crowded
