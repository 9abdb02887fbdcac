"""From an image to ellipses with covariance and status: candidates, sub-pixel fit, and the judgement of each."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mjtactile.errors import InputError
from mjtactile.sensing import candidates, edges, ellipse, profiles
from mjtactile.types import Array, Ellipses, Image

Polarity = Literal["dark", "bright"]
CUT, NOT_ELLIPSE, TOUCHING = "cut by image border", "not an ellipse", "touches another"
_SMALL = 6.0  # px, semi-minor axis
LOW_CONTRAST, GLARE, SMALL = "low contrast", "glare or dirt", "too small"


def detect(image: NDArray | Image, camera: Any = None, *, polarity: Polarity = "dark",
           min_radius_px: float = 1.5) -> Ellipses:
    """Find circular markers in `image` ((H, W) or (H, W, 3) uint8 or uint16, or an `Image`).

    `polarity`: markers "dark" on bright or "bright" on dark. `camera` is accepted so that all stages look alike;
    ellipses are in distorted pixels, as in the image. `min_radius_px`: smallest semi-minor axis looked for.

    Returns `Ellipses` in reading order of detection; those whose status is not "ok" are likely markers that should not
    be trusted. No marker gives an empty result. Raises InputError for a wrong shape, type or option.
    """
    grey = grey_image(image)
    if polarity not in ("dark", "bright"):
        raise InputError(f"{polarity!r}", source="detect", field="polarity", choices=("dark", "bright"))
    eight = grey if grey.dtype == np.uint8 else _eight_bit(grey)
    found = candidates.find(eight if polarity == "dark" else 255 - eight, min_radius_px)
    found = _plausible(found, min_radius_px)
    fit = _fit(grey, found)
    status = _judge(fit, found, polarity, grey.shape, min_radius_px)
    keep = status != ""
    axes, angle = ellipse.axes_from_shape(fit.shape[keep])
    cov = ellipse.covariance_of_axes(fit.cov[keep], axes, angle)
    return Ellipses(fit.center[keep], axes, angle, cov, status[keep])


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


def _fit(grey: NDArray, found: candidates.Candidates) -> edges.EdgeFit:
    """Profiles for what is large enough; the image itself, which costs ten times more per pixel, for the small."""
    axes, _ = ellipse.axes_from_shape(found.shape)
    large = axes[:, 1] >= _SMALL
    if large.all() and len(large):
        return profiles.fit(grey, found.center, found.shape)
    fit = edges.fit(grey, found.center[~large], found.shape[~large])
    if large.any():
        fit = edges.merge(~large, fit, profiles.fit(grey, found.center[large], found.shape[large]))
    return fit


def _eight_bit(grey: NDArray) -> NDArray[np.uint8]:
    """Candidates need contrast, not depth: stretch what is really used of 16 bits to 8."""
    low, high = np.percentile(grey[::4, ::4], [0.1, 99.9])
    return np.clip((grey - low) * (255 / max(high - low, 1.0)), 0, 255).astype(np.uint8)


def _plausible(found: candidates.Candidates, min_radius_px: float) -> candidates.Candidates:
    """Drop what cannot be a marker: too small or long, or a border far from its own ellipse."""
    axes, _ = ellipse.axes_from_shape(found.shape)
    a, b = axes.T
    good = (b >= min_radius_px) & (b > 0.3 * a) & (found.misfit < 1.2 + 0.15 * b)
    return found.take(good)


def _judge(fit: edges.EdgeFit, found: candidates.Candidates, polarity: str, size: tuple[int, ...],
           min_radius_px: float) -> NDArray[np.str_]:
    """Status of each fit; "" for what is no marker at all."""
    axes, _ = ellipse.axes_from_shape(fit.shape)
    b = axes[:, 1]
    contrast = (fit.outside - fit.inside) * (1 if polarity == "dark" else -1)
    noise = np.maximum(fit.residual, 1e-3)
    moved = np.linalg.norm(fit.center - found.center, axis=1)
    extent = np.sqrt(fit.shape[:, [0, 2]] ** 2 + fit.shape[:, 1:2] ** 2)
    out = ((fit.center - extent < 1) | (fit.center + extent > np.array([size[1], size[0]]) - 2)).any(axis=1)
    status = np.full(len(b), "ok", dtype="<U24")
    status[contrast < 8 * noise] = LOW_CONTRAST
    status[fit.residual > 0.12 * contrast] = NOT_ELLIPSE
    status[fit.lost > 0.25] = GLARE
    status[b < min_radius_px] = SMALL
    status[out | found.cut] = CUT
    wrong = (contrast < 3 * noise) | (moved > 1 + 0.3 * b) | (b < 0.5 * min_radius_px) | (axes[:, 0] > 5 * b)
    status[wrong] = ""
    return status
