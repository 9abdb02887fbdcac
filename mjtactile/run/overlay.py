"""A camera's image with the ellipses that are fitted in it, as people look at it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Image
from mjtactile.sensing.image.ellipse import boundary, shape_from_axes
from mjtactile.sensing.image.markers import detect

TRUSTED, FLAGGED = (83, 211, 57), (60, 60, 230)  # blue, green, red


def with_ellipses(image: Image, width: int) -> NDArray[np.uint8]:
    """The image `width` pixels wide, blue, green, red (h, w, 3); ellipses green where they are trusted, red where not."""
    scale = width / image.pixels.shape[1]
    small = cv2.resize(image.pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    picture = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR).astype(np.uint8)
    ellipses = detect(image)
    if len(ellipses):
        curves, _ = boundary(ellipses.center_px, shape_from_axes(ellipses.semi_axes_px, ellipses.angle), 40)
        points = np.round(16 * ((curves + 0.5) * scale - 0.5)).astype(np.int32)
        for curve, status in zip(points, ellipses.status, strict=True):
            cv2.polylines(picture, [curve], True, TRUSTED if status == "ok" else FLAGGED, 1, cv2.LINE_AA, shift=4)
    return picture
