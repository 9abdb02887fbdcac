"""Recursive Bayesian estimate of the friction coefficient of a grip, which may change.

The state is the coefficient mu on a grid, and if it is steady or falls (a surface gets wet).
Prediction: a steady mu diffuses, a falling one approaches a low value; the mode changes at constant
rates. Update with each image: the utilization of a finger, shear over normal force, is mu while it
slides and a lower bound otherwise; the answer of the shear to a change of the grip. The only tuning
is a risk: `grip` is the minimum force at which the predicted probability of slip is below it.
Equations: docs/theory/friction.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np

from mjtactile.core.signature_checks import above, validated, within
from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation.slip_signs import ANSWER_MIN, NONE, Signs, SlipSigns

GRID = np.geomspace(0.10, 1.30, 49)
"""Values of the friction coefficient."""
_SPACING = math.log(GRID[1] / GRID[0])
_DRIFT = 0.03  # diffusion of a steady ln(mu), 1/sqrt(s)
_FALL, _FLOOR = 4.0, 0.2  # rate, 1/s, at which a falling mu approaches a low value
_RATES = (0.02, 10.0)  # rates of the mode, 1/s, to falling and back
_PRIOR = (0.7, 0.25)  # mean and standard deviation of mu before the first image
# signs of slip (`mjtactile bench friction`): probability of a report at full utilization; error of
# the utilization of the sliding fingers as a measurement of mu, relative; odds of a false report
_REPORTED = 0.6
_SLIP_SD = (0.15, 0.10, 0.10)
_FALSE = (0.1, 0.1, 0.001)
# a slip at less than this fraction of the utilization held before: odds that friction has not
# changed
_SAME, _UNCHANGED = 1.1, 0.01
_USED_SD = (0.025, 0.006)  # sd of the utilization: constant part, and times 1 N over the force
_WRONG = 0.01  # probability of an image in which that model does not hold
# fraction of an image that is independent of the previous one: in a steady hold its errors last
_INDEPENDENT = 0.5
# of a sign in its first image and in further ones: a report lasts for five images; none is more
# evidence while the grip is loosened on purpose
_WEIGHTS = ((0.03, 0.03), (0.6, 0.0), (0.6, 0.0), (1.0, 0.5))
_TEST_WEIGHT = 0.5
# change of the shear over that of the grip, sticking and sliding; sd of it, and per change
_ANSWERS = (0.15, 0.65)
_ANSWER_SD = (0.08, 0.2)
_LAG = 0.15  # prediction time, s: an image, the servo and its play
_LOAD_SD = 0.06  # relative sd of load over grip: errors of the forces and of their control


@dataclass(frozen=True)
class FrictionFilter(SlipSigns):
    """Posterior of the friction coefficient.

    A controller stores it as plain values (`vars`) and restores it (`FrictionFilter(**kept)`).

    Attributes:
        weights: (2 n) Probability of each value of `GRID` steady and falling; empty: the prior.
    """

    weights: Sequence[float] = ()

    @validated(period=above(0))
    def after(
        self,
        touch: Sequence[Touch],
        period: float,
        *,
        is_test: bool = False,
        is_hanging: bool = True,
    ) -> FrictionFilter:
        """Update with one image.

        Args:
            touch: Current touches.
            period: Time since the previous image, s.
            is_test: True while the grip is loosened on purpose, so that no slip is evidence.
            is_hanging: True if the fingers alone carry the object, so that a loss of shear is slip.

        Returns:
            The updated filter; without a usable image only the prediction.
        """
        predicted = _transition(period) @ self._posterior()
        signs = self.signs(touch, period, is_hanging=is_hanging)
        if signs is None:
            return replace(self, weights=predicted.tolist())
        was_held = signs.drag < _SAME * self.held * signs.press
        likelihood = [
            _likelihood(signs, self.strongest, is_test, possible_slip)
            for possible_slip in (_UNCHANGED if was_held else 1.0, 1.0)
        ]
        weights = predicted * np.concatenate(likelihood)
        return FrictionFilter(
            weights=(weights / weights.sum()).tolist(),
            **self.followed(signs, period, is_test=is_test),
        )

    def density(self) -> Array:
        """Return the probability (n,) of each value of `GRID`."""
        return self._posterior().reshape(2, -1).sum(axis=0)

    @validated(probability=within(0, 1))
    def quantile(self, probability: float) -> float:
        """Return the coefficient that the true one is below with this probability."""
        return float(np.interp(probability, np.cumsum(self.density()), GRID))

    @validated(risk=within(0, 1))
    def utilization(self, risk: float) -> float:
        """Return the maximum load over grip force at which the probability of slip is `risk`.

        It holds for the time at which a command acts: the posterior is predicted by the lag of
        sensor and jaws.
        """
        ahead = (_transition(_LAG) @ self._posterior()).reshape(2, -1).sum(axis=0)
        return float(np.interp(risk, np.maximum.accumulate(_slip_given() @ ahead), GRID))

    @validated(risk=within(0, 1))
    def grip(self, load: float, risk: float) -> float:
        """Return the minimum normal force per finger, N, for a shear `load` per finger, N."""
        return load / self.utilization(risk)

    def _posterior(self) -> Array:
        return np.array(self.weights) if len(self.weights) else _prior()


def _normal_cdf(value: Array) -> Array:
    """Return the standard normal distribution function, by the logistic approximation."""
    return 1.0 / (1.0 + np.exp(-1.702 * np.clip(value, -20.0, 20.0)))


@cache
def _prior() -> Array:
    """Return the prior, (2 n): a fall is as likely as after a long time."""
    fraction = _RATES[0] / (_RATES[0] + _RATES[1])
    return np.concatenate([(1 - fraction) * _common(), fraction * _common()])


@cache
def _common() -> Array:
    """Return the probability (n,) of each value of `GRID` for any pair of surfaces."""
    mean, sd = _PRIOR
    weights = GRID * np.exp(-0.5 * ((GRID - mean) / sd) ** 2)  # intervals grow with mu
    return weights / weights.sum()


@lru_cache(maxsize=16)
def _transition(period: float) -> Array:
    """Return the probabilities (2 n, 2 n) of the next state (row) given the present one."""
    steady = _diffusion(_DRIFT * math.sqrt(period)) * _common()[:, None]
    steady /= steady.sum(axis=0)
    falling = _fall(_FALL * period)
    both = sum(_RATES)
    start, end = (rate / both * (1 - math.exp(-both * period)) for rate in _RATES)
    return np.block([[(1 - start) * steady, end * falling], [start * steady, (1 - end) * falling]])


def _diffusion(sd: float) -> Array:
    """Return a kernel of this standard deviation, relative, on the grid."""
    steps = np.abs(np.subtract.outer(np.arange(len(GRID)), np.arange(len(GRID))))
    if sd > _SPACING:
        return np.exp(-0.5 * (steps * _SPACING / sd) ** 2)
    near = 0.5 * (sd / _SPACING) ** 2  # a random walk to the neighbours
    return np.where(steps == 0, 1 - 2 * near, np.where(steps == 1, near, 0.0))


def _fall(fraction: float) -> Array:
    """Return the kernel of an exponential approach to `_FLOOR`, by linear interpolation."""
    lower = np.where(GRID > _FLOOR, _FLOOR + (GRID - _FLOOR) * math.exp(-fraction), GRID)
    grid_index = np.interp(lower, GRID, np.arange(len(GRID)))
    rows = np.arange(len(GRID))[:, None]
    return np.maximum(1.0 - np.abs(rows - grid_index), 0.0)


def _likelihood(
    signs: Signs, before: int = NONE, is_test: bool = False, possible_slip: float = 1.0
) -> Array:
    """Return the likelihood (n,) of the evidence of one image (Eq. R2 to R5), after signs up to
    `before` in the same report, with the odds that a slip is possible in the mode."""
    sd = _USED_SD[0] + _USED_SD[1] / signs.press
    used = max(signs.recent)
    beyond = (signs.recent[-1] - GRID) / sd
    possible = _WRONG + (1 - _WRONG) * _normal_cdf(2.0 - beyond)
    answer = _answer(signs.harder, signs.more, _normal_cdf(beyond))
    if signs.slip == NONE:
        sign = 1 - _REPORTED * _normal_cdf((used / GRID - 1) / _SLIP_SD[-1])
    else:  # it slides: the utilization is mu
        state_index = signs.slip - 1
        deviation = (signs.slid / GRID - 1) / _SLIP_SD[state_index]
        sign = _FALSE[state_index] + possible_slip * np.exp(-0.5 * deviation**2)
    is_further = before >= signs.slip
    weight = _WEIGHTS[signs.slip][is_further]
    if signs.slip and is_further and signs.harder > ANSWER_MIN:
        weight = 0.0  # the report may outlast the slip; the answer of the shear decides
    if is_test and signs.slip == NONE:
        weight = _TEST_WEIGHT
    return (possible * answer) ** _INDEPENDENT * sign**weight


def _answer(harder: float, more: float, slides: Array) -> Array:
    """Return the likelihood (n,) of a change of the shear after a change of the grip, relative."""
    if not abs(harder) > ANSWER_MIN:
        return np.ones_like(slides)
    sd = _ANSWER_SD[0] + _ANSWER_SD[1] * abs(harder)
    sticking, sliding = (
        0.1 + math.exp(-0.5 * ((more - fraction * harder) / sd) ** 2) for fraction in _ANSWERS
    )
    return sticking + (sliding - sticking) * slides


@cache
def _slip_given() -> Array:
    """Return P(slip) for each load over grip of the grid (row) and each coefficient (column)."""
    ratio = GRID[:, None]
    return _normal_cdf((ratio - GRID[None, :]) / (_LOAD_SD * ratio))
