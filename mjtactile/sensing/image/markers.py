"""From an image to ellipses with covariance and status: candidates, sub-pixel fit, and the
judgement of each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.types import Ellipses, Image
from mjtactile.kernels import kernel
from mjtactile.sensing.image import candidates, edges, ellipse, profiles
from mjtactile.sensing.settings import DEFAULTS, MarkerSettings, Settings, as_numbers

Polarity = Literal["dark", "bright"]
CUT = "cut by image border"
NOT_ELLIPSE = "not an ellipse"
TOUCHING = "touches another"
LOW_CONTRAST = "low contrast"
GLARE = "glare or dirt"
SMALL = "too small"
MOTION = "motion blur"
BLURRED = "too blurred"
LONG = "too long"
NO_FIT = "no fit"
MOVED = "edge lies elsewhere"
# in the order of the numbers in mjtactile/kernels/candidates.c
STATUSES = np.array(
    [
        "ok",
        CUT,
        NOT_ELLIPSE,
        TOUCHING,
        LOW_CONTRAST,
        GLARE,
        SMALL,
        MOTION,
        BLURRED,
        LONG,
        NO_FIT,
        MOVED,
    ],
    dtype="<U24",
)


def detect(
    image: NDArray | Image,
    camera: Any = None,
    *,
    polarity: Polarity = "dark",
    min_radius_px: float = 1.5,
    settings: Settings = DEFAULTS,
) -> Ellipses:
    """Find circular markers in `image` ((H, W) or (H, W, 3) uint8 or uint16, or an `Image`).

    `polarity`: markers "dark" on bright or "bright" on dark. `camera` is accepted so that all
    stages look alike; ellipses are in distorted pixels, as in the image. `min_radius_px`: smallest
    semi-minor axis looked for; from 4 px on, the search runs at half the resolution (the fit does
    not).

    Returns `Ellipses` in reading order of detection; those whose status is not "ok" are likely
    markers that should not be trusted. No marker gives an empty result. Raises InputError for a
    wrong shape, type or option.
    """
    check_polarity(polarity)
    return as_ellipses(
        *search(grey_image(image), polarity, min_radius_px=min_radius_px, settings=settings)
    )


def search(
    grey: NDArray,
    polarity: Polarity = "dark",
    *,
    min_radius_px: float = 1.5,
    settings: Settings = DEFAULTS,
) -> tuple[edges.EdgeFit, NDArray[np.str_]]:
    """`detect` in a grey image (H, W): the fits, and the status of each."""
    eight = eight_bit(grey)
    s = settings.markers
    found = candidates.find(
        eight if polarity == "dark" else 255 - eight, min_radius_px, settings.candidates
    )
    found = found.take(implausible(found, min_radius_px, s) == "")
    fit = fit_candidates(grey, found, settings)
    status, keep = judge(fit, found, polarity, grey.shape, min_radius_px, s)
    return (fit, status) if keep.all() else (fit.take(keep), status[keep])


def check_polarity(polarity: str) -> None:
    """Raises InputError for another than those that there are."""
    if polarity not in ("dark", "bright"):
        raise InputError(
            f"{polarity!r}", source="detect", field="polarity", choices=("dark", "bright")
        )


def as_ellipses(fit: edges.EdgeFit, status: NDArray[np.str_]) -> Ellipses:
    """Fits as semi-axes and angles."""
    n = len(fit.center)
    axes = np.empty((n, 2))
    angle = np.empty(n)
    cov = np.empty((n, 5, 5))
    kernel("ellipse_axes")(n, fit.shape, fit.cov, axes, angle, cov)
    return Ellipses(fit.center, axes, angle, cov, status)


def grey_image(image: NDArray | Image) -> NDArray:
    """The grey channel (H, W), uint8 or uint16, of an array or `Image`; colour by the mean of its
    channels."""
    pixels = np.asarray(image.pixels if isinstance(image, Image) else image)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{pixels.dtype} pixels", source="image", field="dtype", choices=("uint8", "uint16")
        )
    if pixels.ndim == 3 and pixels.shape[2] in (1, 3, 4):
        colour = pixels[..., :3]
        pixels = (
            np.rint(colour.mean(axis=2)).astype(pixels.dtype)
            if pixels.shape[2] > 1
            else pixels[..., 0]
        )
    if pixels.ndim != 2 or min(pixels.shape) < 8:
        raise InputError(
            f"shape {pixels.shape} is not an image of at least 8 x 8 pixels",
            source="image",
            field="shape",
            choices=("(H, W)", "(H, W, 3)"),
        )
    return np.ascontiguousarray(pixels)


def fit_candidates(
    grey: NDArray, found: candidates.Candidates, settings: Settings
) -> edges.EdgeFit:
    """An ellipse for each candidate, with a covariance that can be believed or is as large as the
    marker."""
    return sound(_fit(grey, found, settings))


def _fit(grey: NDArray, found: candidates.Candidates, settings: Settings) -> edges.EdgeFit:
    """Profiles for what is large enough; the image itself, which costs ten times more per pixel,
    for the small."""
    s = settings.markers
    by_pixels = settings.edges
    axes, _ = ellipse.axes_from_shape(found.shape)
    large = axes[:, 1] >= s.room
    if not large.any():
        return edges.fit(grey, found.center, found.shape, s=by_pixels)
    fit = profiles.fit(grey, found.center[large], found.shape[large], settings.profiles)
    # `edges` knows of no motion
    blurred = (fit.blur * s.blurred > axes[large, 1]) & (fit.motion < s.motion)
    # a drawing, or a blur that was taken for size
    sharpest = fit.blur < 1.01 * settings.profiles.sharpest
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
    return edges.merge(
        large,
        fit,
        edges.fit(grey, found.center[~large], found.shape[~large], others=others, s=by_pixels),
    )


def sound(fit: edges.EdgeFit) -> edges.EdgeFit:
    """`fit` with a covariance as large as the marker, and no trust, where the numbers are not those
    of a minimum."""
    variances = np.diagonal(fit.cov, axis1=1, axis2=2)
    bad = ~(
        np.isfinite(fit.cov.sum(axis=(1, 2)) + fit.residual)
        & (variances.min(axis=1, initial=np.inf) > 0)
    )
    if not bad.any():
        return fit
    size = np.square(fit.shape[bad]).sum(axis=1)
    cov = fit.cov.copy()
    residual = fit.residual.copy()
    cov[bad] = np.eye(5) * size[:, None, None]
    residual[bad] = 1e9
    return replace(fit, cov=cov, residual=residual)


def eight_bit(grey: NDArray) -> NDArray[np.uint8]:
    """Candidates need contrast, not depth: stretch what is really used of 16 bits to 8."""
    if grey.dtype == np.uint8:
        return grey
    low, high = np.percentile(grey[::4, ::4], [0.1, 99.9])
    return np.clip((grey - low) * (255 / max(high - low, 1.0)), 0, 255).astype(np.uint8)


def implausible(
    found: candidates.Candidates, min_radius_px: float, s: MarkerSettings
) -> NDArray[np.str_]:
    """Why each cannot be a marker: too small or long, or a border far from its own ellipse (further
    if cut); "" if it can."""
    codes = np.empty(len(found), np.int64)
    kernel("judge_borders")(
        len(found), found.shape, found.misfit, found.cut, min_radius_px, as_numbers(s), codes
    )
    return np.where(codes, STATUSES[codes], "")


def judge(
    fit: edges.EdgeFit,
    found: candidates.Candidates,
    polarity: str,
    size: tuple[int, ...],
    min_radius_px: float,
    s: MarkerSettings,
) -> tuple[NDArray[np.str_], NDArray[np.bool_]]:
    """Status (N,) of each fit, and whether (N,) it is likely a marker at all, be it to be trusted
    or not.

    An edge is weak, an outline no ellipse, or part of it covered, by the fit's own numbers and by
    what is usual in this image; blur is the image's, so that a marker much sharper or more blurred
    than the others was not understood; and a fit that left its candidate behind found something
    else.
    """
    n = len(fit.center)
    levels = np.stack([fit.inside, fit.outside])
    codes = np.empty(n, np.int64)
    keep = np.empty(n, np.int64)
    numbers = np.stack([fit.blur, fit.residual, fit.pixels, fit.lost, fit.motion])
    kernel("judge_fits")(
        n,
        fit.center,
        fit.shape,
        fit.cov,
        levels,
        numbers,
        found.center,
        found.shape,
        found.misfit,
        found.cut,
        1.0 if polarity == "dark" else -1.0,
        *size,
        min_radius_px,
        as_numbers(s),
        codes,
        keep,
    )
    return STATUSES[codes], keep != 0
