"""Marker ellipses of an image: candidates, sub-pixel fit with covariance, and status of each."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.types import Ellipses, Image
from mjtactile.sensing.image import candidates
from mjtactile.sensing.image.edge_fit import EdgeFit
from mjtactile.sensing.image.ellipse import boundary, shape_from_axes
from mjtactile.sensing.image.ellipse_fit import as_ellipses, fit_candidates
from mjtactile.sensing.image.fit_validation import implausible, validate_fits
from mjtactile.sensing.settings import DEFAULTS, LocateSettings, Settings

Polarity = Literal["dark", "bright"]


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
    stages have the same interface. Ellipses are in distorted pixels, like the image.
    `min_radius_px` is the minimum semi-minor axis. From 4 px on, the search runs at half the
    resolution (the fit does not).

    Returns `Ellipses` in order of detection. Those whose status is not "ok" are likely markers that
    should not be trusted. Without markers the result is empty. Raises InputError for a wrong shape,
    type or option.
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
    max_radius_px: float = math.inf,
    settings: Settings = DEFAULTS,
) -> tuple[EdgeFit, NDArray[np.str_]]:
    """Run `detect` on a gray image (H, W) and return the fits with a status for each. Candidates
    larger than `max_radius_px` are skipped, as is a round frame's own edge."""
    eight = eight_bit(grey)
    s = settings.markers
    found = candidates.find(
        eight if polarity == "dark" else 255 - eight, min_radius_px, settings.candidates
    )
    found = found.take(implausible(found, min_radius_px, s) == "")
    if max_radius_px < math.inf:
        found = found.take(np.sqrt(found.shape[:, 0] * found.shape[:, 2]) < max_radius_px)
    fit = fit_candidates(grey, found, settings)
    status, keep = validate_fits(fit, found, polarity, grey.shape, min_radius_px, s)
    return (fit, status) if keep.all() else (fit.take(keep), status[keep])


def check_polarity(polarity: str) -> None:
    """Raise InputError for an unknown polarity."""
    if polarity not in ("dark", "bright"):
        raise InputError(
            f"{polarity!r}", source="detect", field="polarity", choices=("dark", "bright")
        )


def grey_image(image: NDArray | Image) -> NDArray:
    """Return the gray channel (H, W), uint8 or uint16, of an array or `Image`. Color images are
    converted by the mean of their channels."""
    pixels = np.asarray(image.pixels if isinstance(image, Image) else image)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{pixels.dtype} pixels", source="image", field="dtype", choices=("uint8", "uint16")
        )
    if pixels.ndim == 3 and pixels.shape[2] in (1, 3, 4):
        colour = pixels[..., :3]
        if pixels.shape[2] > 1:
            pixels = np.rint(colour.mean(axis=2)).astype(pixels.dtype)
        else:
            pixels = pixels[..., 0]
    if pixels.ndim != 2 or min(pixels.shape) < 8:
        raise InputError(
            f"shape {pixels.shape} is not an image of at least 8 x 8 pixels",
            source="image",
            field="shape",
            choices=("(H, W)", "(H, W, 3)"),
        )
    return np.ascontiguousarray(pixels)


def eight_bit(grey: NDArray) -> NDArray[np.uint8]:
    """Stretch the used range of 16 bits to 8, since candidates need contrast, not depth."""
    if grey.dtype == np.uint8:
        return grey
    low, high = np.percentile(grey[::4, ::4], [0.1, 99.9])
    return np.clip((grey - low) * (255 / max(high - low, 1.0)), 0, 255).astype(np.uint8)


def is_overexposed(
    grey: NDArray, ellipses: Ellipses, polarity: Polarity, s: LocateSettings
) -> bool:
    """Return True if the bright side of most edges is at the end of the camera's range (8, 10, 12,
    14 or 16 bits)."""
    top = int(grey.max(initial=0))
    good = ellipses.status == "ok"
    if not good.any() or top + 1 not in (2**8, 2**10, 2**12, 2**14, 2**16):
        return False
    shape = shape_from_axes(ellipses.semi_axes_px[good], ellipses.angle[good])
    if polarity == "dark":
        aside = shape + [s.ground_distance, 0.0, s.ground_distance]
    else:
        aside = s.inside_fraction * shape
    u, v = (
        np.rint(boundary(ellipses.center_px[good], aside, 8)[0]).astype(np.int64).transpose(2, 0, 1)
    )
    inside = (u >= 0) & (v >= 0) & (u < grey.shape[1]) & (v < grey.shape[0])
    return bool((grey[v[inside], u[inside]] > s.clipped_level * top).mean() > s.clipped_fraction)
