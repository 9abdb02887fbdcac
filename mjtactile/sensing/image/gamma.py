"""Conversion of gray levels to light, and estimation of gamma from the circles.

The conversion inverts the camera's gamma curve. A gamma curve E = c L^(1/gamma) makes a blurred
edge asymmetric. Its half-way level is no longer at half of the light. At gamma 2.2 this moves the
edges of dark circles inward by 0.2 px and more. This asymmetry determines gamma. One common gamma
and every circle's ten parameters (`edges`) are fitted to the original gray levels. Gamma is
eliminated by its Schur complement. This requires blur of at least half a pixel. The dark level must
be well below the bright one. Clipping and sharpening are excluded, because they add asymmetry. The
scatter between circles gives the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Ellipses
from mjtactile.kernels import kernel
from mjtactile.sensing.image import edge_fit, ellipse
from mjtactile.sensing.image.edge_bands import NeighborMarkers, Pixels
from mjtactile.sensing.settings import DEFAULTS, GammaSettings, Settings

_MIDDLE = 128.0  # grey levels, to which levels are relative inside
_DARKEST = 1e-6  # light of a model's pixel, which may not be negative
_STEPS = 12
_MAX_STEP = 0.3  # of log gamma
_SETTLED = 1e-3
_WHITE = 65535


@dataclass(frozen=True)
class Gamma:
    """Estimate of a camera's gamma with standard deviation, from `circles` circles; NaN without
    enough data."""

    value: float
    sd: float
    circles: int

    def contradicts(self, assumed: float, s: GammaSettings) -> bool:
        """Return True if the image clearly has another gamma than `assumed`."""
        deviation = abs(np.log(self.value / assumed))
        return bool(self.deviates(assumed, s) and deviation > s.min_sds * self.sd / self.value)

    def deviates(self, assumed: float, s: GammaSettings) -> bool:
        """Return True if the image has another gamma than `assumed`, clearly or not."""
        # never for an unknown value
        return bool(abs(np.log(self.value / assumed)) > s.min_log_change)

    def size_uncertainty(self, assumed: float, s: GammaSettings) -> float:
        """Return the standard deviation, px, of circle sizes if `assumed` was used."""
        return s.size_per_log * float(np.hypot(np.log(self.value / assumed), self.sd / self.value))


UNKNOWN = Gamma(np.nan, np.nan, 0)


def linear_light(grey: NDArray, gamma: float) -> NDArray:
    """Convert gray levels (H, W), uint8 or uint16, of a camera with E = c L^(1/gamma) to 16 bits of
    light."""
    if gamma == 1:
        return grey
    top = np.iinfo(grey.dtype).max
    table = np.rint((np.arange(top + 1) / top) ** gamma * _WHITE).astype(np.uint16)
    return table[grey]


def estimate_gamma(grey: NDArray, ellipses: Ellipses, settings: Settings = DEFAULTS) -> Gamma:
    """Estimate the gamma of the image `grey` (H, W) from the detected `ellipses`."""
    s = settings.gamma
    b = ellipses.semi_axes_px[:, 1]
    use = np.flatnonzero((ellipses.status == "ok") & (b >= s.min_radius))
    if len(use) < s.min_circles:
        return UNKNOWN
    use = use[np.argsort(np.abs(b[use] - np.median(b[use])), kind="stable")][: s.max_circles]
    center = ellipses.center_px[use]
    shape = ellipse.shape_from_axes(ellipses.semi_axes_px, ellipses.angle)[use]
    pixels, origin = _pixels(grey, center, shape, settings)
    return _fit(pixels, _start(pixels, center - origin, shape, s), s)


def _pixels(grey: NDArray, center: Array, shape: Array, settings: Settings) -> tuple[Pixels, Array]:
    """Collect the pixels of the bands, without softening."""
    around = NeighborMarkers.of(
        center, shape, len(center), settings.gamma.profile_half_width, settings.edges
    )
    pixels, _, origin = edge_fit.gather(
        grey, center, shape, around, settings.gamma.profile_half_width
    )
    return pixels, origin


def _start(pixels: Pixels, center: Array, shape: Array, s: GammaSettings) -> Array:
    """Return initial parameters (n, 10), as those of `edges` but with levels in gray levels."""
    theta = np.zeros((len(center), edge_fit.PARAMETERS))
    theta[:, :2] = center
    theta[:, 2:5] = shape
    theta[:, 9] = s.start_blur
    p, q, r = pixels.spread(ellipse.inverse_shape(shape).T)
    cu, cv = pixels.spread(center.T)
    dx = pixels.x - cu
    dy = pixels.y - cv
    inside = np.hypot(p * dx + q * dy, q * dx + r * dy) < 1
    for column, part in ((5, inside), (6, ~inside)):
        level = pixels.sums(np.where(part, pixels.observed, 0)) / np.maximum(
            pixels.sums(part.astype(float)), 1
        )
        theta[:, column] = np.maximum(level, 1.0)
    return theta


def _fit(pixels: Pixels, theta: Array, s: GammaSettings) -> Gamma:
    """Fit log gamma and the parameters of all circles at once, by Gauss-Newton steps."""
    log_gamma = float(np.log(s.start_gamma))
    step = np.inf
    single = np.zeros(len(theta))
    sd = np.ones(len(theta))
    for k in range(_STEPS):
        H, sums = equations(pixels, theta, float(np.exp(log_gamma)), robust=k > 0)
        H += 1e-6 * np.eye(edge_fit.PARAMETERS)
        right, mixed = np.split(sums[:, : 2 * edge_fit.PARAMETERS], 2, axis=1)
        squares, pulls, residual, kept, *at_edge = sums[:, 2 * edge_fit.PARAMETERS :].T
        solved = np.linalg.solve(H, np.stack([right, mixed], axis=2))
        information = squares - (mixed * solved[..., 1]).sum(axis=1)
        pull = pulls - (mixed * solved[..., 0]).sum(axis=1)
        variance = residual / np.maximum(kept - edge_fit.PARAMETERS, 1)
        known = information > 0  # rounding may give zero or less where a fit is degenerate
        single = np.divide(pull, information, out=np.zeros(len(theta)), where=known)
        sd = np.full(len(theta), np.inf)
        np.sqrt(np.divide(variance, information, out=sd, where=known), out=sd)
        total = (1 / sd**2).sum()
        mean = (single / sd**2).sum() / total if total > 0 else 0.0
        step = float(np.clip(mean, -_MAX_STEP, _MAX_STEP))
        theta = _bounded_step(theta, solved[..., 0] - solved[..., 1] * step)
        log_gamma += step
        if abs(step) < _SETTLED:
            break
    settled = abs(step) < _SETTLED and float(np.median(theta[:, 9])) >= s.min_blur
    misfit = _edge_misfit(residual, kept, *at_edge)
    return _from_estimate(log_gamma, single, sd, misfit, s) if settled else UNKNOWN


def _edge_misfit(residual: Array, kept: Array, edge_residual: Array, edge_kept: Array) -> float:
    """Return by how much the rms residual at the edges exceeds that elsewhere, relative to it.

    It is zero for noise. Compression, and other processing of the image, changes the form of the
    edge, and a gamma can take the part of this change that is asymmetric.
    """
    elsewhere = np.maximum((residual - edge_residual) / np.maximum(kept - edge_kept, 1), 1e-9)
    ratio = np.sqrt(edge_residual / np.maximum(edge_kept, 1e-9) / elsewhere)
    return max(float(np.median(ratio)) - 1, 0.0)


def equations(pixels: Pixels, theta: Array, gamma: float, *, robust: bool) -> tuple[Array, Array]:
    """Return the normal matrices (n, 10, 10) of the parameters, and sums (n, 26) over the pixels.

    The sums are products of the parameters' derivatives with the residual (10), and with the
    derivative by log gamma (10). Then follow that derivative squared, its product with the
    residual, the residual squared, and the weights. The last two are their parts at the edge, in
    proportion to the square of its slope. Gray levels are relative to `_MIDDLE`, so that
    light is of order one. L = model(..., I = i^gamma, O = o^gamma, ...), E = L^(1/gamma).
    """
    H = np.empty((len(theta), edge_fit.PARAMETERS, edge_fit.PARAMETERS))
    sums = np.empty((len(theta), 2 * edge_fit.PARAMETERS + 6))
    observed = (len(pixels.x), pixels.counts, pixels.x, pixels.y, pixels.observed)
    curve = np.array([gamma, _MIDDLE, _DARKEST, robust])
    kernel("gamma_equations")(len(theta), *observed, curve, theta, H, sums)
    return H, sums


def _bounded_step(theta: Array, change: Array) -> Array:
    """Return the parameters after a step that is limited to plausible values."""
    change[:, :5] = np.clip(change[:, :5], -0.5, 0.5)
    new = theta + change
    new[:, 5:7] = np.clip(new[:, 5:7], 0.5 * theta[:, 5:7], 2 * theta[:, 5:7])
    new[:, 7:9] = np.clip(new[:, 7:9], -0.02, 0.02)
    new[:, 9] = np.clip(new[:, 9], 0.25, 4.0)
    return new


def _from_estimate(
    log_gamma: float, single: Array, sd: Array, misfit: float, s: GammaSettings
) -> Gamma:
    """Return the common gamma, with a standard deviation that includes the scatter of circles and
    the `misfit` of their edges. `single` are the deviations of the circles from it. It is unknown
    if it is not plausible for a camera."""
    good = np.isfinite(single) & np.isfinite(sd)
    gamma = float(np.exp(log_gamma))
    if good.sum() < s.min_circles or not s.range[0] <= gamma <= s.range[1]:
        return UNKNOWN
    scatter = max(float(np.median(np.abs(single[good]) / sd[good])) / 0.6745, 1.0)
    random = scatter / np.sqrt((1 / sd[good] ** 2).sum())
    model = np.hypot(s.model_sd_fraction, s.misfit_sd * misfit)
    return Gamma(gamma, gamma * float(np.hypot(random, model)), int(good.sum()))
