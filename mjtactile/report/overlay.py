"""Camera image with overlaid fitted ellipses, for display."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Ellipses, Image, SyntheticEllipses
from mjtactile.sensing.image.ellipse import boundary, shape_from_axes
from mjtactile.sensing.image.ellipse_fit import as_ellipses
from mjtactile.sensing.image.markers import detect, grey_image, search
from mjtactile.sensing.image.tracking import Tracks

# blue, green, red
TRUSTED = (83, 211, 57)
FLAGGED = (60, 60, 230)
_PAPER = 190  # grey level of a missing image
_NO_PIXELS = (480, 640)
# Among this many circles, one this much larger than the median is not a marker. The markers of a
# sensor are alike, and within a bulge the image size varies by less than a factor of two.
_FEWEST = 4
_TOO_LARGE = 3.0


def find_ellipses(image: Image) -> Ellipses:
    """Return the ellipses in the image without a round frame's edge, or the synthetic ones."""
    if isinstance(image, SyntheticEllipses) and image.ellipses is not None:
        return image.ellipses
    found = detect(image)
    if len(found) < _FEWEST:
        return found
    radii = np.sqrt(found.semi_axes_px.prod(axis=1))
    largest = _TOO_LARGE * float(np.median(radii))
    if radii.max() < largest:
        return found
    # repeat the search: the first one flagged ellipses that touch the edge
    return as_ellipses(*search(grey_image(image), max_radius_px=largest))


def followed(image: Image, tracks: Tracks | None) -> Ellipses | None:
    """Return the ellipses of `tracks` if they are from this image and complete."""
    if tracks is None or tracks.time != image.time or len(tracks.fit.center) < tracks.count:
        return None
    return as_ellipses(tracks.fit, np.full(tracks.count, "ok", dtype="<U24"))


def with_ellipses(image: Image, width: int, ellipses: Ellipses | None = None) -> NDArray[np.uint8]:
    """Return a color image `width` px wide with trusted (green) and other (red) ellipses."""
    ellipses = find_ellipses(image) if ellipses is None else ellipses
    pixels = image.pixels if image.pixels.size else np.full(_NO_PIXELS, _PAPER, np.uint8)
    scale = width / pixels.shape[1]
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    view = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR).astype(np.uint8)
    if len(ellipses):
        curves, _ = boundary(
            ellipses.center_px, shape_from_axes(ellipses.semi_axes_px, ellipses.angle), 40
        )
        points = np.round(16 * ((curves + 0.5) * scale - 0.5)).astype(np.int32)
        for curve, status in zip(points, ellipses.status, strict=True):
            cv2.polylines(
                view, [curve], True, TRUSTED if status == "ok" else FLAGGED, 1, cv2.LINE_AA, shift=4
            )
    return view
