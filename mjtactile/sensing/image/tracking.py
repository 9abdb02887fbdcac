"""Marker tracking in a sequence of images.

Each fit starts at the predicted position of its marker. It converges from two pixels away. Markers
move less than that between images. A fit is accepted if its position is near the prediction, its
shape and contrast are those of the previous image, and its residual is like those of the other
markers. The whole image is searched for markers if a fit is rejected, after a gap, at regular
intervals, and after an image with an unusual residual. While markers are missing, every second
image is searched.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Ellipses, Image
from mjtactile.sensing.image import edge_fit, markers
from mjtactile.sensing.image.candidates import Candidates
from mjtactile.sensing.image.ellipse_fit import as_ellipses, fit_candidates
from mjtactile.sensing.image.fit_validation import validate_fits
from mjtactile.sensing.settings import DEFAULTS, Settings, TrackingSettings


@dataclass(frozen=True, eq=False)
class Tracks:
    """Trusted fits of the image at `time`, s, and the velocity of their centers (N, 2), px/s.
    `count` is the expected number of markers. The next `images_before_search` images need no search
    of the whole image."""

    time: float
    fit: edge_fit.EdgeFit
    velocity: Array
    count: int
    images_before_search: int


def follow(
    image: Image,
    before: Tracks | None,
    count: int,
    *,
    min_radius_px: float,
    max_radius_px: float = math.inf,
    settings: Settings = DEFAULTS,
) -> tuple[Ellipses, Tracks | None]:
    """Detect `count` dark markers in `image`, as `markers.detect` does, and return the next tracks.
    `before`: tracks from the last image, None for the first."""
    grey = markers.grey_image(image)
    s = settings.tracking
    fit = None if before is None else _tracked(grey, image.time, before, min_radius_px, settings)
    if fit is not None and before is not None:
        step = image.time - before.time
        velocity = (fit.center - before.fit.center) / step if step > 0 else before.velocity
        status = np.full(len(fit.center), "ok", dtype="<U24")
        return as_ellipses(fit, status), Tracks(
            image.time, fit, velocity, count, before.images_before_search - 1
        )
    fit, status = markers.search(
        grey, min_radius_px=min_radius_px, max_radius_px=max_radius_px, settings=settings
    )
    good = fit.take(status == "ok")
    if not len(good.center):
        return as_ellipses(fit, status), None
    if len(good.center) < len(status) or not _residuals_alike(good, s):
        images_before_search = 0
    elif len(good.center) == count:
        images_before_search = s.images_between_searches
    else:
        images_before_search = 1
    tracks = Tracks(
        image.time, good, _velocity(good.center, image.time, before), count, images_before_search
    )
    return as_ellipses(fit, status), tracks


def _tracked(
    grey: NDArray, time: float, before: Tracks, min_radius_px: float, settings: Settings
) -> edge_fit.EdgeFit | None:
    """Return the fits of `before` tracked to this image. Return None if a search is due or a fit is
    rejected."""
    s = settings.tracking
    step = time - before.time
    if before.images_before_search < 1 or not 0 <= step <= s.max_gap:
        return None
    n = len(before.fit.center)
    center = before.fit.center + step * before.velocity
    start = Candidates(center, before.fit.shape, np.zeros(n), np.zeros(n, bool))
    fit = fit_candidates(grey, start, settings)
    status, _ = validate_fits(fit, start, "dark", grey.shape, min_radius_px, settings.markers)
    if (status == "ok").all() and _as_predicted(fit, start, before.fit, s):
        return fit
    return None


def _as_predicted(
    fit: edge_fit.EdgeFit, start: Candidates, before: edge_fit.EdgeFit, s: TrackingSettings
) -> bool:
    """Return True if all fits have the expected position and appearance."""
    contrast = fit.outside - fit.inside
    previous = before.outside - before.inside
    return _residuals_alike(fit, s) and bool(
        np.abs(fit.center - start.center).max() < s.position_tolerance
        and np.abs(fit.shape - start.shape).max() < s.shape_tolerance
        and np.abs(contrast - previous).max() < s.contrast_tolerance * previous.min()
    )


def _residuals_alike(fit: edge_fit.EdgeFit, s: TrackingSettings) -> bool:
    """Return True if no fit has a much larger residual than the others.

    A larger residual shows that an edge is partly hidden.
    """
    return bool(
        fit.residual.max() < s.max_residual * statistics.median(fit.residual.tolist())
        and fit.lost.max() < s.max_lost_weight
    )


def _velocity(center: Array, time: float, before: Tracks | None) -> Array:
    """Return the velocity (N, 2), px/s, of the circles at `center` (N, 2); 0 if unknown.

    A circle is assigned to the nearest predicted one of the previous image.
    """
    unknown = np.zeros_like(center)
    if before is None or not before.time < time:
        return unknown
    step = time - before.time
    d2 = np.square(center[:, None] - (before.fit.center + step * before.velocity)).sum(axis=2)
    nearest = d2.argmin(axis=1)
    # within its radius
    is_same = d2[np.arange(len(center)), nearest] < np.square(before.fit.shape[nearest, 0])
    return np.where(is_same[:, None], (center - before.fit.center[nearest]) / step, unknown)
