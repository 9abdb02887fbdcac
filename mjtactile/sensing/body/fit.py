"""A family's numbers from markers: Gauss-Newton with Levenberg's damping, the film as forward
model, and the family's evidence (docs/equations.md, Eq. F18-F20)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from mjtactile.core.types import Array, Touch
from mjtactile.film import FilmState
from mjtactile.film.state import AREA, PRESSURE
from mjtactile.sensing.body.families import Family, Hint, lies_on
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.settings import BodySettings

_TRIED, _HOPELESS = 3, 2.0  # rounds, after which a cost so many times the best is given up
_MOST_ROUNDS = 10
_SETTLED = 0.5  # of the cost: less does not tell one body from another
_DAMPING = (1e-2, 1e-8, 1e3)  # first, least, most
_APPROACH = (1.2, 0.7, 0.3, 0.0)  # mm above the start: the film is pressed in steps
_FORCE_STEPS = 3


@dataclass(frozen=True, eq=False)
class Data:
    """What one image shows: the `heights` (n,) m of markers `ids` (n,), the whitening `root` (n, n)
    of their noise, and the normal `force` N that was felt."""

    ids: NDArray[np.int64]
    heights: Array
    root: Array
    force: float

    @classmethod
    def of(cls, touch: Touch, by_gas: Array, s: BodySettings, drift: tuple[float, float]) -> Data:
        """Of a touch with markers.

        Args:
            touch: What was felt.
            by_gas: (N,) m, the markers' heights by a share of gas.
            s: Settings.
            drift: What may have changed since the rest was measured, as sd: share of gas, and m
                that the camera has moved.
        """
        markers = touch.markers
        assert markers is not None
        gas = drift[0] * by_gas[markers.ids]
        cov = np.diag(markers.cov_p[:, 2, 2] + s.film_sd**2) + drift[1] ** 2 + np.outer(gas, gas)
        root = solve_triangular(np.linalg.cholesky(cov), np.eye(len(cov)), lower=True)
        return cls(markers.ids, markers.p_SM[:, 2], root, touch.force_normal)

    def residual(self, seen: Array) -> Array:
        """Whitened residuals (k, n) of markers predicted at `seen` (k, N, 3)."""
        return (seen[:, self.ids, 2] - self.heights) @ self.root.T


@dataclass(frozen=True, eq=False)
class Prior:
    """What is believed of a family's numbers, over the family's own sd: `mean` (k,) and
    `precision` (k, k)."""

    mean: Array
    precision: Array

    @classmethod
    def of(cls, family: Family) -> Prior:
        """Before any image."""
        return cls(family.mean / family.sd, np.eye(len(family.sd)))

    def cost(self, t: Array) -> float:
        """Of numbers `t` (k,) over their sd."""
        off = t - self.mean
        return float(off @ self.precision @ off)


@dataclass(frozen=True, eq=False)
class Fit:
    """A body of one family.

    Attributes:
        family: Its family.
        hint: What its numbers count from.
        theta: Its numbers.
        prior: What was believed of them.
        chi2: Sum of squares of the whitened markers.
        curvature: (k, k) of half of it by the numbers over their sd.
        heights_off: (n,) whitened heights that it leaves.
        state: The film on it.
        gradients: (k, 3) of normal force, N, area, m^2, and pressure, Pa, by its numbers.
    """

    family: Family
    hint: Hint
    theta: Array
    prior: Prior
    chi2: float
    curvature: Array
    heights_off: Array
    state: FilmState
    gradients: Array

    @property
    def misfit(self) -> float:
        """Mean square of the whitened heights."""
        return self.chi2 / len(self.heights_off)

    @property
    def area(self) -> float:
        """Of the sheet that lies on it, m^2."""
        return lies_on(self.family, self.theta, self.hint) * self.state.area

    def precision_with(self, noise: float) -> Array:
        """(k, k) of the numbers over their sd, where variances are `noise` times what is
        believed."""
        return self.curvature / noise + self.prior.precision

    def cov_with(self, noise: float) -> Array:
        """Covariance (k, k) of the numbers."""
        return np.linalg.inv(self.precision_with(noise)) * np.outer(self.family.sd, self.family.sd)

    def log_evidence_with(self, noise: float) -> float:
        """Log of the family's evidence (Laplace) of this image where the markers' variances are
        `noise` times what is believed."""
        cost = self.chi2 / noise + self.prior.cost(self.theta / self.family.sd)
        spread = np.linalg.slogdet(self.precision_with(noise))[1]
        known = np.linalg.slogdet(self.prior.precision)[1]
        return -0.5 * (cost + float(spread - known))

    def then(self, noise: float, hint: Hint, loose: Array) -> Prior:
        """What is believed of the next image's numbers, which count from `hint` and may have
        changed by `loose` (k,) sd."""
        theta = self.theta.copy()
        theta[:2] += 1e3 * (self.hint.place - hint.place)
        theta[2] += 1e3 * (self.hint.height - hint.height)
        sd = self.family.sd
        cov = np.linalg.inv(self.precision_with(noise)) + np.diag((loose / sd) ** 2)
        return Prior(theta / sd, np.linalg.inv(cov))


def fit(
    forward: Forward,
    family: Family,
    hint: Hint,
    starts: Sequence[Array],
    data: Data,
    prior: Prior,
    known: float = np.inf,
) -> Fit | None:
    """The body of `family` that explains the markers best; None where no film can rest on it.

    Args:
        forward: The film.
        family: The family.
        hint: What its numbers count from.
        starts: Its numbers to start from; the one that explains most after the body is pressed in
            as far as it feels the force is gone on with.
        data: The image.
        prior: What is believed.
        known: The cost that another family reached: what stays far above it is given up.

    Returns:
        The body.
    """
    sd = family.sd
    reached = [_approach(forward, family, hint, start, data) for start in starts]
    begun = [
        (*_cost(forward, one[0] / sd, one[1].x[None], data, prior), *one)
        for one in reached
        if one is not None
    ]
    if not begun:
        return None
    residual, cost, theta, state = min(begun, key=lambda one: one[1])
    slopes = _slopes(forward, family, hint, theta, state, data)
    damping = _DAMPING[0]
    for count in range(_MOST_ROUNDS):
        if slopes is None:
            return None
        if count >= _TRIED and cost > _HOPELESS * (known + len(residual)):
            break
        step = _Step(theta, state, residual, cost, slopes[0])
        better, damping = _improve(forward, family, hint, step, data, prior, damping)
        if better is None:
            break
        gained = cost - better[3]
        theta, state, residual, cost = better
        slopes = _slopes(forward, family, hint, theta, state, data)
        if gained < _SETTLED:
            break
    if slopes is None:
        return None
    J, gradients = slopes
    chi2 = float(residual @ residual)
    return Fit(family, hint, theta, prior, chi2, J.T @ J, residual, state, gradients / sd[:, None])


@dataclass(frozen=True, eq=False)
class _Step:
    """Where a fit stands: numbers, film, whitened heights, cost, and their derivatives."""

    theta: Array
    state: FilmState
    residual: Array
    cost: float
    slopes: Array


def _improve(
    forward: Forward,
    family: Family,
    hint: Hint,
    at: _Step,
    data: Data,
    prior: Prior,
    damping: float,
) -> tuple[tuple[Array, FilmState, Array, float] | None, float]:
    """Numbers with less cost, with their film, residual and cost (None: there are none), and the
    damping from there."""
    sd, J = family.sd, at.slopes
    gradient = J.T @ at.residual + prior.precision @ (at.theta / sd - prior.mean)
    normal = J.T @ J
    while damping < _DAMPING[2]:
        H = normal + prior.precision + damping * np.diag(np.diag(normal) + 1e-3)
        new = np.clip(at.theta - np.linalg.solve(H, gradient) * sd, family.low, family.high)
        batch = forward.solve([family.build(new, hint)], at.state)
        if batch.converged[0]:
            residual, cost = _cost(forward, new / sd, batch.x, data, prior)
            if cost < at.cost:
                return (new, batch[0], residual, cost), max(damping / 10, _DAMPING[1])
        damping = max(10 * damping, 1e-2)
    return None, damping


def _cost(forward: Forward, t: Array, x: Array, data: Data, prior: Prior) -> tuple[Array, float]:
    residual = data.residual(forward.markers(x))[0]
    return residual, float(residual @ residual) + prior.cost(t)


def _slopes(
    forward: Forward, family: Family, hint: Hint, theta: Array, state: FilmState, data: Data
) -> tuple[Array, Array] | None:
    """By each number over its sd: whitened markers (m, k), and (k, 3) force, area, pressure."""
    steps = family.steps / family.sd
    steps = np.where(theta + family.steps > family.high, -steps, steps)
    thetas = theta + np.diag(steps * family.sd)
    batch = forward.solve([family.build(one, hint) for one in (theta, *thetas)], state)
    good = batch.converged
    if not good[0]:
        return None
    residual = data.residual(forward.markers(batch.x))
    J = (residual[1:] - residual[0]) / steps[:, None]
    sums = np.column_stack([-batch.found[:, 2], batch.found[:, AREA], batch.found[:, PRESSURE]])
    gradients = (sums[1:] - sums[0]) / steps[:, None]
    J[~good[1:]] = 0.0
    gradients[~good[1:]] = 0.0
    return J.T, gradients


def _approach(
    forward: Forward, family: Family, hint: Hint, start: Array, data: Data
) -> tuple[Array, FilmState] | None:
    """Press the body in until it feels the force that was felt."""
    theta = np.clip(start, family.low, family.high)
    state = None
    force = 0.0
    for above in _APPROACH:
        trial = theta.copy()
        trial[2] += above
        batch = forward.solve([family.build(trial, hint)], state)
        if not batch.converged[0]:
            break
        state, reached = batch[0], trial
        before, force = force, batch[0].force_normal
        if force > data.force:
            break
    if state is None:
        return None
    theta = reached  # pyright: ignore[reportPossiblyUnboundVariable]
    stiffness = 0.12  # N/mm, of a first touch
    for _ in range(_FORCE_STEPS):
        if abs(force - data.force) < 0.1 * data.force:
            break
        down = np.clip((data.force - force) / max(stiffness, 0.05), -0.5, 0.5)
        trial = theta.copy()
        trial[2] = np.clip(trial[2] - down, family.low[2], family.high[2])
        batch = forward.solve([family.build(trial, hint)], state)
        if not batch.converged[0]:
            break
        before, force = force, batch[0].force_normal
        if abs(down) > 1e-6:
            stiffness = float(np.clip((force - before) / down, 0.05, 2.0))
        theta, state = trial, batch[0]
    return theta, state
