"""Sub-pixel ellipses from edge profiles, for all markers together, at camera rate.

K profiles cross each ellipse along its normals. Filters reduce each to a few values: levels, area,
offset of the edge by a matched filter, width. Robust least squares then move the ellipses. Offsets
first come from the area, which is correct even two pixels away. Then they come from the matched
filter, which is near the Cramer-Rao bound close to the edge.

A disc blurred by a Gaussian of standard deviation sigma has its 50 % level further inward. The
shift is kappa sigma^2/2 (kappa: curvature of the edge). Sigma is measured from the profiles and the
bias is removed. This is first order in kappa sigma; `edges` is for small markers that need more.
The arithmetic is in mjtactile/kernels/ellipse_profiles.c.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.sensing.image.edge_fit import SOFTEN, EdgeFit
from mjtactile.sensing.settings import DEFAULTS, ProfileSettings, as_numbers


def fit(
    image: NDArray, center: Array, shape: Array, s: ProfileSettings = DEFAULTS.profiles
) -> EdgeFit:
    """Fit N ellipses starting from `center` (N, 2), `shape` (N, 3) px, right to about two
    pixels."""
    # Softening makes the image smooth enough for bilinear interpolation. Without it, offsets depend
    # on the edge position within a pixel, by 2 um of depth in the paper's geometry.
    source = cv2.sepFilter2D(image, cv2.CV_32F, SOFTEN, SOFTEN, borderType=cv2.BORDER_REPLICATE)
    n = len(center)
    # these arrays are updated in place
    center = np.array(center, float, order="C")
    shape = np.array(shape, float, order="C")
    cov = np.empty((n, 5, 5))
    levels = np.empty((2, n))
    found = np.empty((5, n))
    kernel("fit_profiles")(
        source, *source.shape, n, center, shape, as_numbers(s), cov, levels, found
    )
    inside, outside = levels
    blur, residual, count, lost, motion = found
    return EdgeFit(center, shape, cov, inside, outside, blur, residual, count, lost, motion)
