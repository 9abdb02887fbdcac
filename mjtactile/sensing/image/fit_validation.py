"""Classification of candidates and fits: markers or not, trusted or not, with a status for each.
The arithmetic is in mjtactile/kernels/candidates.c."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjtactile.kernels import kernel
from mjtactile.sensing.image.candidates import Candidates
from mjtactile.sensing.image.edge_fit import EdgeFit
from mjtactile.sensing.settings import MarkerSettings, as_numbers

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
TEXTURE = "as likely a texture"
# in the order of the status codes in mjtactile/kernels/candidates.c
_REASONS = (CUT, NOT_ELLIPSE, TOUCHING, LOW_CONTRAST, GLARE, SMALL, MOTION, BLURRED, LONG, NO_FIT)
STATUSES = np.array(["ok", *_REASONS, MOVED], dtype="<U24")


def implausible(found: Candidates, min_radius_px: float, s: MarkerSettings) -> NDArray[np.str_]:
    """Return the reason why each candidate cannot be a marker; "" if it can. Reasons: too small or
    long, or a border far from its own ellipse (further if cut)."""
    codes = np.empty(len(found), np.int64)
    kernel("check_borders")(
        len(found), found.shape, found.misfit, found.cut, min_radius_px, as_numbers(s), codes
    )
    return np.where(codes, STATUSES[codes], "")


def validate_fits(
    fit: EdgeFit,
    found: Candidates,
    polarity: str,
    size: tuple[int, ...],
    min_radius_px: float,
    s: MarkerSettings,
) -> tuple[NDArray[np.str_], NDArray[np.bool_]]:
    """Return the status (N,) of each fit, and a mask (N,) of likely markers, trusted or not.

    Weak edges, non-elliptic outlines and partly covered edges are detected from the fit itself. The
    limits are relative to typical values in this image. Blur is common to the image. So a marker
    much sharper or more blurred than the others is rejected. A fit that moved away from its
    candidate fitted something else.
    """
    n = len(fit.center)
    levels = np.stack([fit.inside, fit.outside])
    codes = np.empty(n, np.int64)
    keep = np.empty(n, np.int64)
    measures = np.stack([fit.blur, fit.residual, fit.pixels, fit.lost, fit.motion])
    fits = (fit.center, fit.shape, fit.cov, levels, measures)
    borders = (found.center, found.shape, found.misfit, found.cut)
    image = (1.0 if polarity == "dark" else -1.0, *size)
    options = (min_radius_px, as_numbers(s))
    kernel("check_fits")(n, *fits, *borders, *image, *options, codes, keep)
    return STATUSES[codes], keep != 0
