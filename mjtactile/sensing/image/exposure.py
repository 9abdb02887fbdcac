"""Detection of overexposed images, where clipping around the circles hides the edge positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Ellipses
from mjtactile.sensing.image.ellipse import boundary, shape_from_axes
from mjtactile.sensing.image.markers import Polarity
from mjtactile.sensing.settings import LocateSettings


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
