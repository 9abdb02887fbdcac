"""A family's numbers from markers: Gauss-Newton with Levenberg's damping, the film as forward
model, and the family's evidence (docs/theory/contact_shape.md, Eq. F18-F20)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Prior, begin
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.jacobian import (
    Jacobian,
    approximate_jacobian,
    exact_jacobian,
    learnt,
)
from mjtactile.sensing.contact_shape.levenberg_step import Step, damped_step
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel

_DAMPING = (1e-2, 1e-8, 1e2)  # first, least, most
_GOOD = 0.4  # of what a step promised: the next is damped less
_POLISHED = 2  # times, with exact slopes,
_POLISHING = 2  # of so many films
_POLISH = 0.05
# Of the cost over its noise: what does not tell one body from another; a step that promises so much
# wants fresh slopes; how far behind the best a body is not followed any more
_SETTLED = 0.25
_FAR = 4.0
_BEHIND = 30.0
_PROMISED = 1.5  # times what a step promises, that may come of all that follow
_ALIKE = 0.1  # of how much more is left than of the best: less does not matter


@dataclass(frozen=True, eq=False)
class Fit:
    """A body of one family.

    Attributes:
        family: Its family.
        hint: What its numbers count from.
        at: Its numbers, and the film on it.
        prior: What was believed of them.
        curvature: (k, k) of half the sum of squares of the whitened markers, by the numbers over
            their sd.
        slopes: Of heights and sums.
        felt: N, the normal force of the nodal estimate in its image.
    """

    family: ShapeModel
    hint: InitialGuess
    at: FitState
    prior: Prior
    curvature: Array
    slopes: Jacobian
    felt: float

    @property
    def theta(self) -> Array:
        """Its numbers."""
        return self.at.theta

    @property
    def state(self) -> MembraneSolution:
        """The film on it."""
        return self.at.state

    @property
    def chi2(self) -> float:
        """Sum of squares of the whitened markers."""
        return float(self.at.residual @ self.at.residual)

    @property
    def misfit(self) -> float:
        """Mean square of the whitened heights."""
        return self.chi2 / len(self.at.residual)

    def precision_with(self, noise: float) -> Array:
        """(k, k) of the numbers over their sd, where variances are `noise` times what is
        believed."""
        return self.curvature / noise + self.prior.precision

    def cov_with(self, noise: float) -> Array:
        """Covariance (k, k) of the numbers."""
        sd = self.family.sd
        return np.linalg.inv(self.precision_with(noise)) * np.outer(sd, sd)

    def sums_cov_with(self, noise: float) -> Array:
        """Covariance (8, 8) of the film's sums, by the numbers' alone."""
        cov = np.linalg.inv(self.precision_with(noise))
        return self.slopes.sums @ cov @ self.slopes.sums.T

    def log_evidence_with(self, noise: float) -> float:
        """Log of the family's evidence (Laplace) of this image where the markers' variances are
        `noise` times what is believed."""
        cost = self.chi2 / noise + self.prior.cost(self.theta / self.family.sd)
        spread = np.linalg.slogdet(self.precision_with(noise))[1]
        known = np.linalg.slogdet(self.prior.precision)[1]
        return -0.5 * (cost + float(spread - known))


@dataclass(frozen=True)
class _Enough:
    """Of a fit's cost: what more is worth no step, from where on slopes are to be fresh, and the
    best's own, with the most by which a body may be behind it."""

    settled: float
    far: float
    known: float
    behind: float

    @classmethod
    def of(cls, settled: float, known: float, noise: float, count: int) -> _Enough:
        if np.isinf(known):
            return cls(settled * noise, _FAR * noise, known, known)
        noise = max(noise, known / count)
        return cls(2 * settled * noise, _FAR * noise, known, known + _BEHIND * noise)

    def is_reached(self, cost: float, step: Step, damping: float) -> bool:
        """Whether a fit ends that leaves a cost, and would go on by such a step; a short or much
        damped one says little of what could be."""
        settled = max(self.settled, _ALIKE * (cost - self.known))
        whole = not step.cut and damping <= _DAMPING[0]
        return step.promised < settled or (whole and cost - _PROMISED * step.promised > self.behind)


def refine(
    forward: ForwardModel,
    family: ShapeModel,
    hint: InitialGuess,
    at: FitState,
    data: Data,
    prior: Prior,
    *,
    slopes: Jacobian | None = None,
    rounds: int = 14,
    known: float = np.inf,
    noise: float,
    settled: float = _SETTLED,
) -> Fit:
    """The body of `family` that explains the markers best, from `at`.

    Args:
        forward: The film.
        family: The family.
        hint: What its numbers count from.
        at: Where to begin.
        data: The image.
        prior: What is believed.
        slopes: Found nearby, for an image before (None: they are found here); where they are of no
            use any more, or have gone too far, they are found anew.
        rounds: Films on other bodies, at most.
        known: The sum of squares that another family reached: what stays far above is given up.
        noise: Of the markers' variances, what even the best leaves.
        settled: Of the cost over its noise, what more is worth no step.

    Returns:
        The body; its slopes need not be exact.
    """
    sd = family.sd
    enough = _Enough.of(settled, known, noise, len(at.residual))
    damping = _DAMPING[0] if slopes is None else _DAMPING[1]
    fresh = slopes is not None and slopes.theta is at.theta
    if slopes is None or slopes.worn(family, at.theta):
        fresh = True
        slopes = approximate_jacobian(forward, family, hint, at)
    while rounds > 0:
        step = damped_step(slopes.seen(data), at, family, prior, damping)
        if step.promised > enough.far and not fresh:
            slopes = approximate_jacobian(forward, family, hint, at)
            fresh = True
            continue
        if enough.is_reached(at.cost, step, damping):
            break
        new = begin(forward, family, hint, at.theta + step.by * sd, data, prior, at.state)
        rounds -= 1
        if new is None or new.cost > at.cost:
            if not fresh:
                slopes = approximate_jacobian(forward, family, hint, at)
                fresh = True
            elif damping > _DAMPING[2]:
                break
            else:
                damping = max(10 * damping, _DAMPING[0])
            continue
        gained = at.cost - new.cost
        good = gained > _GOOD * step.promised
        damping = max(damping / 10, _DAMPING[1]) if good else 3 * damping
        fresh = slopes.worn(family, new.theta)
        slopes = (
            approximate_jacobian(forward, family, hint, new)
            if fresh
            else learnt(slopes, sd, at, new)
        )
        at = new
        if gained < enough.settled:
            break
    J = slopes.seen(data)
    return Fit(family, hint, at, prior, J.T @ J, slopes, data.force)


def exactly(
    forward: ForwardModel, fit: Fit, data: Data, noise: float, times: int = _POLISHED
) -> Fit:
    """A fit with exact slopes, for what is said of it; they lead it on to where quick ones do not.

    Args:
        forward: The film.
        fit: Of an image.
        data: The image.
        noise: As for `refine`.
        times: That they may lead it on.

    Returns:
        The same, where its slopes are exact.
    """
    for _ in range(times):
        if fit.slopes.exact:
            return fit
        slopes = exact_jacobian(forward, fit.family, fit.hint, fit.at)
        fit = refine(
            forward,
            fit.family,
            fit.hint,
            fit.at,
            data,
            fit.prior,
            slopes=slopes,
            rounds=_POLISHING,
            noise=noise,
            settled=_POLISH,
        )
    if fit.slopes.exact:
        return fit
    slopes = exact_jacobian(forward, fit.family, fit.hint, fit.at)
    J = slopes.seen(data)
    return replace(fit, curvature=J.T @ J, slopes=slopes)
