"""A family's numbers from markers: Gauss-Newton with Levenberg's damping, the film as forward
model, and the family's evidence (docs/equations.md, Eq. F18-F20)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from mjtactile.core.types import Array, Touch
from mjtactile.film import FilmState, Obstacle
from mjtactile.sensing.body.families import Family, Hint
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.settings import BodySettings

_STEP = 0.03  # of a number's sd: derivatives by differences, above the film's own tolerance
_MOST_ROUNDS = 12
_SETTLED = 0.3  # of the cost: half of what tells one from another by one sd
_DAMPING = (1e-3, 1e-8, 1e4)  # first, least, most
_APPROACH = (1.0, 0.65, 0.35, 0.1, 0.0)  # mm above the start: the film is pressed in steps
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
class Fit:
    """A body of one family.

    Attributes:
        family: Its family.
        hint: What its numbers count from.
        theta: Its numbers.
        cov: Their covariance, without regard to misfit.
        chi2: Sum of squares of the whitened markers.
        curvature: (k, k) of half the cost by the numbers over their sd, the prior left out.
        heights_off: (n,) whitened heights that it leaves.
        state: The film on it.
        gradients: (k, 3) of normal force, N, area, m^2, and pressure, Pa, by its numbers.
    """

    family: Family
    hint: Hint
    theta: Array
    cov: Array
    chi2: float
    curvature: Array
    heights_off: Array
    state: FilmState
    gradients: Array

    def log_evidence_with(self, noise: float) -> float:
        """Log of the family's evidence (Laplace) where the markers' variances are `noise` times
        what is believed."""
        t = (self.theta - self.family.mean) / self.family.sd
        H = self.curvature / noise + np.eye(len(t))
        cost = self.chi2 / noise + float(t @ t)
        return -0.5 * (cost + float(np.linalg.slogdet(H)[1]))

    @property
    def log_evidence(self) -> float:
        """The same, as believed."""
        return self.log_evidence_with(1.0)

    @property
    def area_sd(self) -> float:
        """Of the contact's area, m^2, by the numbers' covariance."""
        return float(np.sqrt(max(self.gradients[:, 1] @ self.cov @ self.gradients[:, 1], 0.0)))

    @property
    def bodies(self) -> tuple[Obstacle, ...]:
        return self.family.build(self.theta, self.hint)


def fit(forward: Forward, family: Family, hint: Hint, start: Array, data: Data) -> Fit | None:
    """The body of `family` that explains the markers best, near `start`; None where no film can
    rest on it."""
    reached = _approach(forward, family, hint, start, data)
    if reached is None:
        return None
    theta, state = reached
    residual, cost = _cost(forward, family, theta, state.x[None], data)
    damping = _DAMPING[0]
    slopes = _slopes(forward, family, hint, theta, state, data)
    for _ in range(_MOST_ROUNDS):
        if slopes is None:
            return None
        J, _ = slopes
        t = (theta - family.mean) / family.sd
        gradient = J.T @ residual + t
        normal = J.T @ J
        moved = False
        while damping < _DAMPING[2]:
            H = normal + np.eye(len(t)) + damping * np.diag(np.diag(normal))
            step = cho_solve(cho_factor(H), -gradient) * family.sd
            new = np.clip(theta + step, family.low, family.high)
            batch = forward.solve([family.build(new, hint)], state)
            if batch.converged[0]:
                tried, less = _cost(forward, family, new, batch.x, data)
                if less < cost:
                    moved = True
                    break
            damping = max(10 * damping, 1e-2)
        if not moved:
            break
        gained = cost - less  # pyright: ignore[reportPossiblyUnboundVariable]
        theta, state, residual, cost = new, batch[0], tried, less  # pyright: ignore[reportPossiblyUnboundVariable]
        damping = max(damping / 10, _DAMPING[1])
        slopes = _slopes(forward, family, hint, theta, state, data)
        if gained < _SETTLED:
            break
    if slopes is None:
        return None
    J, gradients = slopes
    H = J.T @ J + np.eye(len(theta))
    sd = family.sd
    return Fit(
        family,
        hint,
        theta,
        np.linalg.inv(H) * np.outer(sd, sd),
        float(residual @ residual),
        J.T @ J,
        residual,
        state,
        gradients / sd[:, None],
    )


def _cost(
    forward: Forward, family: Family, theta: Array, x: Array, data: Data
) -> tuple[Array, float]:
    residual = data.residual(forward.markers(x))[0]
    t = (theta - family.mean) / family.sd
    return residual, float(residual @ residual + t @ t)


def _slopes(
    forward: Forward, family: Family, hint: Hint, theta: Array, state: FilmState, data: Data
) -> tuple[Array, Array] | None:
    """By each number over its sd: whitened markers (m, k), and (k, 3) force, area, pressure."""
    steps = _STEP * np.where(theta + _STEP * family.sd > family.high, -1.0, 1.0)
    thetas = theta + np.diag(steps * family.sd)
    batch = forward.solve([family.build(one, hint) for one in (theta, *thetas)], state)
    good = batch.converged
    if not good[0]:
        return None
    residual = data.residual(forward.markers(batch.x))
    J = (residual[1:] - residual[0]) / steps[:, None]
    sums = np.column_stack([-batch.found[:, 2], batch.found[:, 8], batch.found[:, 6]])
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
