"""Joint smoothing of ellipse elongation over neighboring circles on one smooth surface.

On a smooth surface the elongation of the ellipses changes smoothly over the image. The estimated
distance of a circle depends on its longest axis. Half of the error of that axis comes from the
ellipse's elongation. With known tilt the variance would be a third (the factor 3 in the Cramer-Rao
bound). The many circles of a board or of a smooth membrane together determine the tilt. Only the
elongation is smoothed, never the size. Each distance still depends on its own marker only.

The elongation is smoothed only if the data support it. The residuals about a second-order field
must not exceed a few standard deviations of the ellipses. Circles with independent tilts stay
unchanged.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array, Ellipses
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.settings import DEFAULTS, NeighborSmoothingSettings

_ROUNDS = 8


def smooth_aspect_ratio(
    ellipses: Ellipses, s: NeighborSmoothingSettings = DEFAULTS.neighbor_smoothing
) -> Ellipses:
    """Return ellipses with their elongation replaced by a smooth common field. The same object is
    returned if the ellipses do not agree with such a field. With S = exp(m I + D), D traceless, m
    (log of the mean radius) is kept. Both entries of D are fitted robustly by second-order
    polynomials in the image. Covariances are rescaled to the observed scatter."""
    ok = np.flatnonzero(ellipses.status == "ok")
    if len(ok) < s.min_circles:
        return ellipses
    axes = ellipses.semi_axes_px[ok]
    angle = ellipses.angle[ok]
    log_ratio = 0.5 * np.log(axes[:, 0] / axes[:, 1])
    D = log_ratio[:, None] * np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    radius = np.sqrt(axes[:, 0] * axes[:, 1])
    cov = ellipse.covariance_of_shape(ellipses.cov[ok], axes, angle)
    # near a circle S = r (I + D): D = ((p - s)/2, q)/r
    variance = (cov[:, 2, 2] + cov[:, 4, 4] - 2 * cov[:, 2, 4]) / 4 + cov[:, 3, 3]
    sd = np.sqrt(variance / 2) / radius
    field, leverage, weight, scatter = _field(ellipses.center_px[ok], D, sd, s.outlier_scatters)
    # the majority must agree, within the error that a camera may add
    if scatter > s.max_scatter or np.median(weight) < s.min_median_weight:
        return ellipses
    agree = weight > s.min_weight  # circles off the surface keep their own elongation
    return _replaced(
        ellipses,
        ok[agree],
        field[agree],
        radius[agree],
        cov[agree],
        (sd * leverage)[agree],
        max(scatter, 1.0),
    )


def _field(uv: Array, D: Array, sd: Array, outlier: float) -> tuple[Array, Array, Array, float]:
    """Fit a smooth field (N, 2) to `D`. Also return its standard deviation relative to that of D
    (N,), and robust weights (N,). The last result is the scatter relative to the predicted standard
    deviation."""
    x = (uv - uv.mean(axis=0)) / np.maximum(np.ptp(uv, axis=0), 1e-9)
    A = np.stack(
        [np.ones(len(x)), x[:, 0], x[:, 1], x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2], axis=1
    )
    A = A / sd[:, None]
    b = D / sd[:, None]
    weight = np.ones(len(x))
    scatter = 1.0
    for _ in range(_ROUNDS):
        AtW = A.T * weight
        normal = np.linalg.inv(AtW @ A + 1e-9 * np.eye(6))
        left = b - A @ (normal @ (AtW @ b))
        size = np.hypot(*left.T)
        scatter = float(np.median(size) / 1.1774)  # of a Rayleigh distribution
        weight = 1 / (1 + (size / (outlier * max(scatter, 1e-9))) ** 4)
    leverage = np.sqrt(np.einsum("ni,ij,nj->n", A, normal, A)) * max(scatter, 1.0)
    return D - left * sd[:, None], leverage, weight, scatter


def _replaced(
    ellipses: Ellipses, at: Array, D: Array, radius: Array, cov: Array, sd: Array, scatter: float
) -> Ellipses:
    half = np.hypot(*D.T)
    axes = radius[:, None] * np.exp(np.stack([half, -half], axis=1))
    angle = 0.5 * np.arctan2(D[:, 1], D[:, 0])
    # variance of the mean radius
    size = (cov[:, 2, 2] + cov[:, 4, 4] + 2 * cov[:, 2, 4]) / 4 * scatter**2
    shared = np.zeros_like(cov)
    shared[:, :2, :2] = cov[:, :2, :2] * scatter**2
    elongation = (sd * radius) ** 2
    shared[:, 2, 2] = shared[:, 4, 4] = size + elongation
    shared[:, 2, 4] = shared[:, 4, 2] = size - elongation
    shared[:, 3, 3] = elongation
    new_axes = ellipses.semi_axes_px.copy()
    new_angle = ellipses.angle.copy()
    new_cov = ellipses.cov.copy()
    new_axes[at] = axes
    new_angle[at] = angle
    new_cov[at] = ellipse.covariance_of_axes(shared, axes, angle)
    return Ellipses(ellipses.center_px, new_axes, new_angle, new_cov, ellipses.status)
