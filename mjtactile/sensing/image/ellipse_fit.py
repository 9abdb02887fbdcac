"""Ellipse fit of each candidate.

Large enough candidates are fitted by edge profiles, others by all their pixels at ten times the
cost.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Ellipses
from mjtactile.kernels import kernel
from mjtactile.sensing.image import edge_fit, ellipse
from mjtactile.sensing.image.candidates import Candidates
from mjtactile.sensing.image.edge_fit import SOFTEN, EdgeFit
from mjtactile.sensing.settings import DEFAULTS, ProfileSettings, Settings, as_numbers


def fit_candidates(grey: NDArray, found: Candidates, settings: Settings) -> EdgeFit:
    """Fit an ellipse to each candidate in a gray image (H, W). The covariance is either reliable,
    or as large as the marker."""
    axes, _ = ellipse.axes_from_shape(found.shape)
    large = axes[:, 1] >= settings.markers.profile_min_radius
    if not large.any():
        return sound(edge_fit.fit(grey, found.center, found.shape, s=settings.edges))
    fit = _by_profiles(grey, found.take(large), axes[large, 1], settings)
    if large.all():
        return sound(fit)
    small = found.take(~large)
    others = found.center[large], found.shape[large]
    by_pixels = edge_fit.fit(grey, small.center, small.shape, others=others, s=settings.edges)
    return sound(edge_fit.merge(large, fit, by_pixels))


def _by_profiles(grey: NDArray, found: Candidates, radius: NDArray, settings: Settings) -> EdgeFit:
    """Fit candidates with these semi-minor axes (N,), px, by profiles. They are fitted again by
    pixels if the blur turns out too large for profiles."""
    s = settings.markers
    fit = fit_profiles(grey, found.center, found.shape, settings.profiles)
    # fits by pixels have no model of motion
    blurred = (fit.blur * s.profile_min_blurs > radius) & (fit.motion < s.min_motion)
    # a drawing, or a blur that was mistaken for size
    sharpest = fit.blur < 1.01 * settings.profiles.sharpest
    if sharpest.any():
        start = found.take(sharpest)
        wide = s.start_blur_fraction * float(ellipse.upper_median(radius[sharpest]))
        again = edge_fit.fit(grey, start.center, start.shape, blur=wide, s=settings.edges)
        settled = again.residual < edge_fit.UNSETTLED
        sharpest[sharpest] = settled
        fit = edge_fit.merge(sharpest, again.take(settled), fit.take(~sharpest))
        blurred &= ~sharpest
    if not blurred.any():
        return fit
    common = float(np.median(fit.blur[blurred]))
    again = edge_fit.fit(
        grey, fit.center[blurred], fit.shape[blurred], blur=common, s=settings.edges
    )
    return edge_fit.merge(blurred, again, fit.take(~blurred))


def sound(fit: EdgeFit) -> EdgeFit:
    """Return `fit` with invalid fits marked as untrusted. Invalid fits have values that are not
    those of a minimum. Their covariance is set to the marker's size."""
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


def as_ellipses(fit: EdgeFit, status: NDArray[np.str_]) -> Ellipses:
    """Convert fits to semi-axes and angles."""
    n = len(fit.center)
    axes = np.empty((n, 2))
    angle = np.empty(n)
    cov = np.empty((n, 5, 5))
    kernel("ellipse_axes")(n, fit.shape, fit.cov, axes, angle, cov)
    darkness = np.log(np.maximum(fit.inside, 0.5) / np.maximum(fit.outside, 0.5))
    return Ellipses(fit.center, axes, angle, cov, status, darkness, fit.outside, fit.blur)


def fit_profiles(
    image: NDArray, center: Array, shape: Array, s: ProfileSettings = DEFAULTS.profiles
) -> EdgeFit:
    """Fit N ellipses by profiles across their edges, for all markers together, at camera rate.

    The start `center` (N, 2) and `shape` (N, 3), px, may be off by about two pixels. Filters reduce
    each profile to a few values: levels, area, offset of the edge by a matched filter, width.
    Robust least squares then move the ellipses. Offsets first come from the area, which is correct
    even two pixels away, then from the matched filter, which is near the Cramer-Rao bound. A disc
    blurred by a Gaussian of standard deviation sigma has its 50 % level further inward by kappa
    sigma^2/2 (kappa: curvature of the edge). Sigma is measured from the profiles and this bias is
    removed. The arithmetic is in mjtactile/kernels/ellipse_profiles.c.
    """
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
