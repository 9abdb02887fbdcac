"""A family's numbers from markers: Gauss-Newton with Levenberg's damping, the film as forward
model, and the family's evidence (docs/equations.md, Eq. F18-F20)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Touch
from mjtactile.film import FilmState
from mjtactile.sensing.body.bodies import Hint
from mjtactile.sensing.body.families import Family
from mjtactile.sensing.body.forward import SUMS, Forward, converged
from mjtactile.sensing.settings import BodySettings

# rounds, after which a cost so many times the best is given up
_TRIED = 4
_HOPELESS = 3.0
_SETTLED = 0.5  # of the cost: less does not tell one body from another
_DAMPING = (1e-2, 1e-8, 1e3)  # first, least, most
_WORN = 8.0  # steps of a derivative that a number may go before it is taken anew


@dataclass(frozen=True, eq=False)
class Data:
    """What one image shows: the `heights` (n,) m of markers `ids` (n,) as a film would have them,
    the whitening `root` (n, n) of their noise, and the normal `force` N that was felt."""

    ids: NDArray[np.int64]
    heights: Array
    root: Array
    force: float

    def raised(self, by: Array) -> Data:
        """As another film has them, whose markers at rest stand `by` (N,) m higher."""
        return replace(self, heights=self.heights + by[self.ids])

    @classmethod
    def of(
        cls, touch: Touch, raised: Array, by_gas: Array, s: BodySettings, drift: tuple[float, float]
    ) -> Data:
        """Of a touch with markers.

        Args:
            touch: What was felt.
            raised: (N,) m by which the markers at rest stand over the film's.
            by_gas: (N,) m, the markers' heights by a share of gas.
            s: Settings.
            drift: What may have changed since the rest was measured, as sd: share of gas, and m
                that the camera has moved.
        """
        from scipy.linalg import solve_triangular  # takes a while to import

        markers = touch.markers
        assert markers is not None
        gas = drift[0] * by_gas[markers.ids]
        cov = np.diag(markers.cov_p[:, 2, 2] + s.film_sd**2) + drift[1] ** 2 + np.outer(gas, gas)
        root = solve_triangular(np.linalg.cholesky(cov), np.eye(len(cov)), lower=True)
        heights = markers.p_SM[:, 2] - raised[markers.ids]
        return cls(markers.ids, heights, root, touch.force_normal)

    def residual(self, heights: Array) -> Array:
        """Whitened residual (n,) of markers predicted at `heights` (N,)."""
        return self.root @ (heights[self.ids] - self.heights)


@dataclass(frozen=True, eq=False)
class Prior:
    """What is believed of a family's numbers, over the family's own sd: `mean` (k,) and
    `precision` (k, k)."""

    mean: Array
    precision: Array

    @classmethod
    def of(cls, family: Family, start: Array) -> Prior:
        """Before any image, where a fit begins at `start` (k,): no direction is likelier than
        another."""
        turns = [name in ("direction", "angle") for name in family.names]
        return cls(np.where(turns, start, family.mean) / family.sd, np.eye(len(family.sd)))

    def cost(self, t: Array) -> float:
        """Of numbers `t` (k,) over their sd."""
        off = t - self.mean
        return float(off @ self.precision @ off)


@dataclass(frozen=True, eq=False)
class Slopes:
    """By each number over its sd: `heights` (N, k) m of the markers and `sums` (8, k) of the film
    (`forward.SUMS`); found where the numbers were `theta` (k,)."""

    heights: Array
    sums: Array
    theta: Array

    def learnt(self, moved: Array, heights: Array, sums: Array) -> Slopes:
        """Broyden's: those nearest these that explain that numbers `moved` (k,) over their sd
        changed heights and sums so."""
        along = moved / max(float(moved @ moved), 1e-12)
        return replace(
            self,
            heights=self.heights + np.outer(heights - self.heights @ moved, along),
            sums=self.sums + np.outer(sums - self.sums @ moved, along),
        )

    def worn(self, family: Family, theta: Array) -> bool:
        """Whether the numbers have gone so far that they are to be found anew."""
        return bool((np.abs(theta - self.theta) > _WORN * family.steps).any())


@dataclass(frozen=True, eq=False)
class At:
    """Where a fit stands: the numbers `theta`, the film on them, its markers' `heights` (N,) m, the
    whitened `residual`, and the `cost`."""

    theta: Array
    state: FilmState
    heights: Array
    residual: Array
    cost: float


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
    """

    family: Family
    hint: Hint
    at: At
    prior: Prior
    curvature: Array
    slopes: Slopes

    @property
    def theta(self) -> Array:
        """Its numbers."""
        return self.at.theta

    @property
    def state(self) -> FilmState:
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


def begin(
    forward: Forward,
    family: Family,
    hint: Hint,
    theta: Array,
    data: Data,
    prior: Prior,
    state: FilmState | None,
) -> At | None:
    """The film on a body of numbers `theta`, from `state`; None: it finds no rest.

    Args:
        forward: The film.
        family: The family.
        hint: What its numbers count from.
        theta: Its numbers.
        data: The image.
        prior: What is believed.
        state: The film before.

    Returns:
        Where a fit may begin.
    """
    theta = np.clip(theta, family.low, family.high)
    batch = forward.solve([family.build(theta, hint)], state)
    if not converged(batch):
        return None
    heights = forward.heights(batch.x)[0]
    residual = data.residual(heights)
    cost = float(residual @ residual) + prior.cost(theta / family.sd)
    return At(theta, batch[0], heights, residual, cost)


def _step(J: Array, at: At, sd: Array, prior: Prior, damping: float) -> tuple[Array, float]:
    """One damped Gauss-Newton step from `at`, in sd, and by how much it should lower the cost."""
    gradient = J.T @ at.residual + prior.precision @ (at.theta / sd - prior.mean)
    normal = J.T @ J
    H = normal + prior.precision + damping * np.diag(np.diag(normal) + 1e-3)
    step = -np.linalg.solve(H, gradient)
    return step, float(-(gradient @ step))


def refine(
    forward: Forward,
    family: Family,
    hint: Hint,
    at: At,
    data: Data,
    prior: Prior,
    *,
    slopes: Slopes | None = None,
    rounds: int = 10,
    known: float = np.inf,
) -> Fit | None:
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
        rounds: At most so many.
        known: The sum of squares that another family reached: what stays far above is given up.

    Returns:
        The body; None where no film rests nearby.
    """
    sd = family.sd
    damping = _DAMPING[0] if slopes is None else _DAMPING[1]
    fresh = slopes is None or slopes.worn(family, at.theta)
    if slopes is None or fresh:
        slopes = find_slopes(forward, family, hint, at)
    for count in range(rounds):
        is_hopeless = at.cost > _HOPELESS * (known + len(at.residual))
        if count >= _TRIED and is_hopeless:
            break
        step, promised = _step(data.root @ slopes.heights[data.ids], at, sd, prior, damping)
        if promised < _SETTLED:
            break
        new = begin(forward, family, hint, at.theta + step * sd, data, prior, at.state)
        if new is None or new.cost > at.cost:
            if damping > _DAMPING[2]:
                break
            if fresh:
                damping = max(10 * damping, 1e-2)
            else:
                slopes = find_slopes(forward, family, hint, at)
                fresh = True
            continue
        gained = at.cost - new.cost
        fresh = slopes.worn(family, new.theta)
        slopes = find_slopes(forward, family, hint, new) if fresh else _learnt(slopes, sd, at, new)
        at = new
        damping = max(damping / 10, _DAMPING[1])
        if gained < _SETTLED:
            break
    J = data.root @ slopes.heights[data.ids]
    return Fit(family, hint, at, prior, J.T @ J, slopes)


def _learnt(slopes: Slopes, sd: Array, at: At, new: At) -> Slopes:
    """Slopes that say of the step from `at` to `new` what came of it."""
    moved = (new.theta - at.theta) / sd
    sums = new.state.found[SUMS] - at.state.found[SUMS]
    return slopes.learnt(moved, new.heights - at.heights, sums)


def find_slopes(forward: Forward, family: Family, hint: Hint, at: At) -> Slopes:
    """Slopes at a body, by differences of films that start from the one on it.

    Args:
        forward: The film.
        family: The family.
        hint: What its numbers count from.
        at: Where.

    Returns:
        The slopes; nothing of a number by which no film rests.
    """
    steps = np.where(at.theta + family.steps > family.high, -family.steps, family.steps)
    batch = forward.solve([family.build(one, hint) for one in at.theta + np.diag(steps)], at.state)
    over = (batch.converged / (steps / family.sd))[:, None]
    heights = (forward.heights(batch.x) - at.heights) * over
    sums = (batch.found[:, SUMS] - at.state.found[SUMS]) * over
    return Slopes(heights.T, np.where(over == 0, 0.0, sums).T, at.theta)
