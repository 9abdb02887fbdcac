"""Update of a fit to the next image by its exact Jacobian, without a membrane solution
(docs/theory/contact_shape.md, Eq. F19)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic.solution import AREA
from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Prior
from mjtactile.sensing.contact_shape.forward_model import SUMS
from mjtactile.sensing.contact_shape.gauss_newton import Fit, step_limits

# A change up to either limit is linear: derivative steps, standard deviations of the parameter
_STEPS = 4.0
_DEVIATIONS = 1.0
_SIGMAS = 3.0  # of the difference of two misfits


@dataclass(frozen=True, eq=False)
class Linearization:
    """Linear model of the next images: the `fit` of an earlier image, with an exact Jacobian, and
    the `prior` of the parameters relative to the same guess."""

    fit: Fit
    prior: Prior
    _gains: dict[bytes, _Gain] = field(default_factory=dict, repr=False)

    def update(self, data: Data, noise: float) -> Fit | None:
        """Fit the linear model to an image. None: the change is too large, or the markers
        contradict it. Marker variances are multiplied by `noise`."""
        gain = self._gain(data)
        fit, family = gain.fit, self.fit.family
        before, slopes = fit.at, fit.slopes
        by = gain.pull + gain.step @ data.residual(before.heights)
        change = by * family.sd
        theta = before.theta + change
        if (np.abs(change) > gain.limit(noise)).any():
            return None
        heights = before.heights + slopes.heights @ by
        left = data.residual(heights)
        square = float(left @ left)
        misfit = square / len(left)
        expected = self.fit.misfit * (1 + _SIGMAS * math.sqrt(4 / len(left)))
        inside = (theta >= family.low).all() and (theta <= family.high).all()
        if misfit > expected or not inside:
            return None
        found = before.state.found.copy()
        found[SUMS] += slopes.sums @ by
        if found[AREA] <= 0:
            return None
        cost = square + self.prior.cost(theta / family.sd)
        at = FitState(theta, replace(before.state, found=found), heights, left, cost)
        return fit.updated(at, gain.seen.T @ left, data.force)

    def _gain(self, data: Data) -> _Gain:
        """Return the gain for images with these markers. Their noise is assumed to be that of the
        first such image."""
        key = data.ids.tobytes()
        if key not in self._gains:
            self._gains[key] = _Gain.of(self.fit, self.prior, data)
        return self._gains[key]


@dataclass(frozen=True, eq=False)
class _Gain:
    """Solved linear least squares for one set of markers. The scaled parameters change by `pull`
    (k,) plus `step` (k, n) times the whitened residual. `seen` (n, k) is the Jacobian of the
    whitened markers. `fit` is the fit with its covariance for these markers and the prior."""

    fit: Fit
    seen: Array
    step: Array
    pull: Array

    @classmethod
    def of(cls, fit: Fit, prior: Prior, data: Data) -> _Gain:
        seen = fit.slopes.seen(data)
        residual = data.residual(fit.at.heights)
        same = replace(
            fit, prior=prior, curvature=seen.T @ seen, gradient=seen.T @ residual, _covs={}
        )
        t = fit.theta / fit.family.sd
        precision = same.precision_with(1.0)
        step = -np.linalg.solve(precision, seen.T)
        pull = -np.linalg.solve(precision, prior.precision @ (t - prior.mean))
        return cls(same, seen, step, pull)

    def limit(self, noise: float) -> Array:
        """Return the maximum change (k,) of the parameters."""
        family, theta = self.fit.family, self.fit.theta
        sd = np.sqrt(self.fit.cov_with(noise).diagonal())
        linear = np.maximum(_STEPS * family.steps, _DEVIATIONS * sd)
        return np.minimum(linear, step_limits(family, theta))
