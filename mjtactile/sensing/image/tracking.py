"""Marker tracking in a sequence of images.

Fits start at predicted positions, with occasional searches of the whole image. A fit finds its edge
from two pixels away, and between images markers move less. A fit is accepted if it ended near its
prediction. It must have the marker's earlier shape and contrast, and a residual like the others'.
Otherwise the whole image is searched. It is also searched after a gap, at regular intervals, and
after any suspicious image. While markers are missing, it is searched every other time.
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
    `count` is the expected number of markers. `left` is the number of following images that need no
    search."""

    time: float
    fit: edge_fit.EdgeFit
    velocity: Array
    count: int
    left: int


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
        return as_ellipses(fit, status), Tracks(image.time, fit, velocity, count, before.left - 1)
    fit, status = markers.search(
        grey, min_radius_px=min_radius_px, max_radius_px=max_radius_px, settings=settings
    )
    good = fit.take(status == "ok")
    if not len(good.center):
        return as_ellipses(fit, status), None
    if len(good.center) < len(status) or not _calm(good, s):
        left = 0
    elif len(good.center) == count:
        left = s.images_between_searches
    else:
        left = 1
    tracks = Tracks(image.time, good, _velocity(good.center, image.time, before), count, left)
    return as_ellipses(fit, status), tracks


def _tracked(
    grey: NDArray, time: float, before: Tracks, min_radius_px: float, settings: Settings
) -> edge_fit.EdgeFit | None:
    """Return the fits of `before` tracked to this image. Return None if a search is due or a fit is
    rejected."""
    s = settings.tracking
    step = time - before.time
    if before.left < 1 or not 0 <= step <= s.max_gap:
        return None
    n = len(before.fit.center)
    center = before.fit.center + step * before.velocity
    start = Candidates(center, before.fit.shape, np.zeros(n), np.zeros(n, bool))
    fit = fit_candidates(grey, start, settings)
    status, _ = validate_fits(fit, start, "dark", grey.shape, min_radius_px, settings.markers)
    if (status == "ok").all() and _believable(fit, start, before.fit, s):
        return fit
    return None


def _believable(
    fit: edge_fit.EdgeFit, start: Candidates, before: edge_fit.EdgeFit, s: TrackingSettings
) -> bool:
    """Return True if all fits have the expected position and appearance."""
    contrast = fit.outside - fit.inside
    was = before.outside - before.inside
    return _calm(fit, s) and bool(
        np.abs(fit.center - start.center).max() < s.position_tolerance
        and np.abs(fit.shape - start.shape).max() < s.shape_tolerance
        and np.abs(contrast - was).max() < s.contrast_tolerance * was.min()
    )


def _calm(fit: edge_fit.EdgeFit, s: TrackingSettings) -> bool:
    """Return True if no fit has a larger residual than the others: no object lies on a marker's
    edge."""
    return bool(
        fit.residual.max() < s.max_residual * statistics.median(fit.residual.tolist())
        and fit.lost.max() < s.max_lost_weight
    )


def _velocity(center: Array, time: float, before: Tracks | None) -> Array:
    """Return the velocity (N, 2), px/s, of the circles at `center` (N, 2); 0 if unknown. It follows
    from the nearest of those `before`."""
    unknown = np.zeros_like(center)
    if before is None or not before.time < time:
        return unknown
    step = time - before.time
    d2 = np.square(center[:, None] - (before.fit.center + step * before.velocity)).sum(axis=2)
    nearest = d2.argmin(axis=1)
    # within a radius of it
    own = d2[np.arange(len(center)), nearest] < np.square(before.fit.shape[nearest, 0])
    return np.where(own[:, None], (center - before.fit.center[nearest]) / step, unknown)
