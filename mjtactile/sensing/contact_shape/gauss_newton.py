"""Gauss-Newton fit of shape parameters to markers, with Levenberg damping.

The membrane is the forward model. The result includes the model evidence
(docs/theory/contact_shape.md, Eq. F18-F20).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Prior, Problem
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.jacobian import Jacobian, approximate_jacobian, exact_jacobian
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel

_DAMPING = (1e-2, 1e-8, 1e2)  # first, minimum, maximum
_GOOD = 0.4  # fraction of the promised gain above which damping decreases
_POLISHED = 1  # number of refinements with exact slopes
_POLISHING = 2  # membrane solutions in each refinement
_POLISH = 0.05
# Thresholds of the cost relative to its noise: gain that does not separate two shapes; promised
# gain that requires fresh slopes; distance behind the best fit where a fit is stopped
_SETTLED = 0.25
_FAR = 4.0
_BEHIND = 16.0
_PROMISED = 1.5  # ratio of the total gain of all following steps to the promised gain of one
_ALIKE = 0.1  # relative excess of the cost over the best fit that does not matter
# Maximum steps: mm and rad, and fractions of a curvature (at least `_FLAT`, 1/m) and of a size
_STRAIGHT = {
    "x": 1.5, "y": 1.5, "z": 0.5, "tilt": 0.1, "lean": 0.1, "direction": 0.35, "angle": 0.35,
}  # fmt: skip
_BEND_STEP = 0.6
_FLAT = 40.0
_SIZE_STEP = 0.25
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted shape of one model.

    Attributes:
        family: Shape model.
        hint: Initial guess that the parameters are relative to.
        at: Parameters and the membrane solution on the shape.
        prior: Prior of the parameters.
        curvature: Hessian (k, k) of half the sum of squares of the whitened residual, by the scaled
            parameters.
        gradient: Gradient (k,) of the same half sum.
        slopes: Derivatives of heights and sums.
        force: Normal force of the nodal estimate in this image, N.
        shared: Values that depend on the nodes of the membrane solution alone. Linear updates, with
            the same nodes, share them.
    """

    family: ShapeModel
    hint: InitialGuess
    at: FitState
    prior: Prior
    curvature: Array
    gradient: Array
    slopes: Jacobian
    force: float
    shared: dict[str, Any] = field(default_factory=dict, repr=False)
    _covs: dict[tuple[float, bool], tuple[Array, Array]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, problem: Problem, at: FitState, slopes: Jacobian) -> Fit:
        """Return the fit that ends at `at`."""
        J = slopes.seen(problem.data)
        curvature, gradient = J.T @ J, J.T @ at.residual
        force = problem.data.force
        return cls(
            problem.family, problem.hint, at, problem.prior, curvature, gradient, slopes, force
        )

    @property
    def theta(self) -> Array:
        """Parameters of the shape."""
        return self.at.theta

    @property
    def state(self) -> MembraneSolution:
        """Membrane solution on the shape."""
        return self.at.state

    @property
    def chi2(self) -> float:
        """Sum of squares of the whitened markers."""
        return float(self.at.residual @ self.at.residual)

    @property
    def misfit(self) -> float:
        """Mean square of the whitened heights."""
        return self.chi2 / len(self.at.residual)

    def once(self, name: str, compute: Callable[[], _T]) -> _T:
        """Return the shared value `name`, computed when it is first needed."""
        if name not in self.shared:
            self.shared[name] = compute()
        return self.shared[name]

    def updated(self, at: FitState, gradient: Array, force: float) -> Fit:
        """Return the fit after a linear update to the state `at`, with the same nodes, Jacobian and
        covariance."""
        return Fit(
            self.family,
            self.hint,
            at,
            self.prior,
            self.curvature,
            gradient,
            self.slopes,
            force,
            self.shared,
            self._covs,
        )

    def precision_with(self, noise: float) -> Array:
        """Return the precision (k, k) of the scaled parameters; marker variances are multiplied by
        `noise`."""
        return self.curvature / noise + self.prior.precision

    def cov_with(self, noise: float) -> Array:
        """Return the covariance (k, k) of the parameters."""
        return self._covs_with(noise)[1]

    def _covs_with(self, noise: float, *, alone: bool = False) -> tuple[Array, Array]:
        """Return the covariances (k, k) of the scaled parameters and of the parameters. They are
        needed several times. `alone`: without the information of earlier images."""
        key = (noise, alone)
        if key not in self._covs:
            sd = self.family.sd
            own = self.curvature / noise + np.eye(len(sd)) if alone else self.precision_with(noise)
            scaled = np.linalg.inv(own)
            self._covs[key] = (scaled, sd[:, None] * scaled * sd)
        return self._covs[key]

    def image_cov_with(self, noise: float) -> Array:
        """Return the covariance (k, k) of the parameters from this image alone, with the prior
        before any image."""
        return self._covs_with(noise, alone=True)[1]

    def sums_cov_with(self, noise: float) -> Array:
        """Return the covariance (8, 8) of the membrane sums due to the parameters alone."""
        return self.slopes.sums @ self._covs_with(noise)[0] @ self.slopes.sums.T

    def log_evidence_with(self, noise: float) -> float:
        """Return the log evidence of the model for this image (Laplace approximation). The marker
        variances are multiplied by `noise`."""
        cost = self.chi2 / noise + self.prior.cost(self.theta / self.family.sd)
        spread = np.linalg.slogdet(self.precision_with(noise))[1]
        known = np.linalg.slogdet(self.prior.precision)[1]
        return -0.5 * (cost + float(spread - known))

    def log_lacking_with(self, noise: float) -> float:
        """Return the log evidence by which the model is behind one that explains the image within
        the marker noise."""
        return max(self.chi2 - len(self.at.residual), 0.0) / (2 * noise)


@dataclass(frozen=True, eq=False)
class Step:
    """Step `by` (k,) of the scaled parameters, with the predicted decrease of the cost. `cut` is
    True if the step was limited."""

    by: Array
    promised: float
    cut: bool


def damped_step(J: Array, at: FitState, family: ShapeModel, prior: Prior, damping: float) -> Step:
    """Compute one damped Gauss-Newton step with the Jacobian (n, k) of the whitened markers by the
    scaled parameters. It is limited per parameter to the range where the membrane responds about
    linearly."""
    gradient = J.T @ at.residual + prior.precision @ (at.theta / family.sd - prior.mean)
    normal = J.T @ J
    H = normal + prior.precision
    H.flat[:: len(H) + 1] += damping * (normal.diagonal() + 1e-3)
    step = -np.linalg.solve(H, gradient)
    maximum = step_limits(family, at.theta) / family.sd
    far = np.abs(step) > maximum
    cut = bool(far.any())
    if cut:
        step = _limited_step(H, gradient, step, maximum, far)
    return Step(step, float(-(2 * gradient + H @ step) @ step), cut)


def _limited_step(
    H: Array, gradient: Array, step: Array, maximum: Array, far: NDArray[np.bool_]
) -> Array:
    """Return a step within its limits. Parameters that would go too `far` are held at their limit,
    and the others are solved again. If these then exceed their limits, the whole step is
    shortened."""
    held = step.copy()
    held[far] = np.clip(step, -maximum, maximum)[far]
    near = ~far
    asked = gradient[near] + H[np.ix_(near, far)] @ held[far]
    held[near] = -np.linalg.solve(H[np.ix_(near, near)], asked)
    falls = (2 * gradient + H @ held) @ held < 0
    if falls and (np.abs(held) <= maximum).all():
        return held
    return step * float((maximum / np.maximum(np.abs(step), 1e-12)).min())


def step_limits(family: ShapeModel, theta: Array) -> Array:
    """Return the maximum step (k,) of each parameter."""
    fixed, curved, sized = _limits(family)
    maximum = fixed + _SIZE_STEP * theta * sized
    if curved.size:
        maximum[curved] = _BEND_STEP * max(_FLAT, *np.abs(theta[curved]).tolist())
    return maximum


@cache
def _limits(family: ShapeModel) -> tuple[Array, NDArray[np.intp], NDArray[np.bool_]]:
    """Return the fixed step limits (k,), the indices of the curvatures, and a mask (k,) of the
    sizes."""
    fixed = np.array([_STRAIGHT.get(name.split("_")[0], 0.0) for name in family.names])
    return fixed, np.flatnonzero(family.curved), family.sized


@dataclass(frozen=True)
class _CostThresholds:
    """Cost thresholds of a fit. A smaller promised gain than `settled` ends the fit. A larger one
    than `far` requires fresh slopes. `known` is the best cost so far, and `behind` the maximum cost
    worth following."""

    settled: float
    far: float
    known: float
    behind: float

    @classmethod
    def of(
        cls, settled: float, far: float, known: float, noise: float, count: int
    ) -> _CostThresholds:
        if np.isinf(known):
            return cls(settled * noise, far * noise, known, known)
        noise = max(noise, known / count)
        return cls(2 * settled * noise, far * noise, known, known + _BEHIND * noise)

    def is_reached(self, cost: float, step: Step, damping: float) -> bool:
        """Return True if the fit should stop at this cost instead of taking the step. A short or
        strongly damped step predicts little of the possible gain."""
        settled = max(self.settled, _ALIKE * (cost - self.known))
        is_full_step = not step.cut and damping <= _DAMPING[0]
        return step.promised < settled or (
            is_full_step and cost - _PROMISED * step.promised > self.behind
        )


def refine(
    problem: Problem,
    at: FitState,
    *,
    slopes: Jacobian | None = None,
    rounds: int = 14,
    known: float = np.inf,
    noise: float,
    settled: float = _SETTLED,
    far: float = _FAR,
) -> Fit:
    """Fit the parameters to the markers, starting from `at`; the fit's Jacobian may be approximate.

    Args:
        problem: Shape model, image and prior.
        at: Start state.
        slopes: Jacobian computed nearby for an earlier image (None: computed here). It is
            recomputed where it does not help any more, or is too far away.
        rounds: Maximum number of membrane solutions.
        known: Sum of squares that another model reached; a fit far above it is stopped.
        noise: Factor on the marker variances that even the best fit leaves.
        settled: Cost relative to the noise below which a step is not worthwhile.
        far: Promised gain relative to the noise that requires a fresh Jacobian.
    """
    family = problem.family
    enough = _CostThresholds.of(settled, far, known, noise, len(at.residual))
    damping = _DAMPING[0] if slopes is None else _DAMPING[1]
    fresh = slopes is not None and slopes.theta is at.theta
    if slopes is None or slopes.worn(family, at.theta):
        fresh = True
        slopes = approximate_jacobian(problem, at)
    while rounds > 0:
        step = damped_step(slopes.seen(problem.data), at, family, problem.prior, damping)
        if step.promised > enough.far and not fresh:
            slopes = approximate_jacobian(problem, at)
            fresh = True
            continue
        if enough.is_reached(at.cost, step, damping):
            break
        new = problem.fit_state(at.theta + step.by * family.sd, at.state)
        rounds -= 1
        if new is None or new.cost > at.cost:
            if not fresh:
                slopes = approximate_jacobian(problem, at)
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
        updated = slopes.updated(family.sd, at, new)
        slopes = approximate_jacobian(problem, new) if fresh else updated
        at = new
        if gained < enough.settled:
            break
    return Fit.of(problem, at, slopes)


def exactly(
    forward: ForwardModel, fit: Fit, data: Data, noise: float, times: int = _POLISHED
) -> Fit:
    """Return the fit with an exact Jacobian, as needed for reporting. It also refines the fit, at
    most `times` times, where the approximate one stopped early."""
    problem = Problem(forward, fit.family, fit.hint, data, fit.prior)
    slopes = fit.slopes if fit.slopes.exact else exact_jacobian(problem, fit.at)
    if times:
        fit = refine(
            problem, fit.at, slopes=slopes, rounds=_POLISHING, noise=noise, settled=_POLISH
        )
        slopes = fit.slopes if fit.slopes.exact else exact_jacobian(problem, fit.at)
    return Fit.of(problem, fit.at, slopes)
