"""Update of a fit to the next image by its exact Jacobian, without a membrane solution
(docs/theory/contact_shape.md, Eq. F19)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Prior
from mjtactile.sensing.contact_shape.forward_model import SUMS
from mjtactile.sensing.contact_shape.gauss_newton import Fit, damped_step

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

    def update(self, data: Data, noise: float) -> Fit | None:
        """Fit the linear model to an image. None: the change is too large, or the markers
        contradict it. Marker variances are multiplied by `noise`."""
        fit, prior = self.fit, self.prior
        family, slopes, before = fit.family, fit.slopes, fit.at
        J = slopes.seen(data)
        residual = data.residual(before.heights)
        start = replace(before, residual=residual)
        step = damped_step(J, start, family, prior, 0.0)
        change = step.by * family.sd
        theta = before.theta + change
        left = residual + J @ step.by
        misfit = float(left @ left) / len(left)
        expected = fit.misfit * (1 + _SIGMAS * math.sqrt(4 / len(left)))
        inside = (theta >= family.low).all() and (theta <= family.high).all()
        if step.cut or misfit > expected or not inside:
            return None
        sd = np.sqrt(np.diag(fit.cov_with(noise)))
        if (np.abs(change) > np.maximum(_STEPS * family.steps, _DEVIATIONS * sd)).any():
            return None
        found = before.state.found.copy()
        found[SUMS] += slopes.sums @ step.by
        heights = before.heights + slopes.heights @ step.by
        cost = len(left) * misfit + prior.cost(theta / family.sd)
        at = FitState(theta, replace(before.state, found=found), heights, left, cost)
        return Fit(family, fit.hint, at, prior, J.T @ J, J.T @ left, slopes, data.force)
