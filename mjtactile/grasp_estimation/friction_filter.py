"""Recursive Bayesian estimate of the friction coefficient of a grip, which may change.

The state is the coefficient mu on a grid, and if it is steady or changing (a surface gets wet).
Prediction: mu diffuses, slowly or fast; the mode changes at constant rates. Update with each image:
the signs of slip, the utilization shear over normal force, which cannot exceed mu, and the answer
of the shear to a change of the grip. The only tuning is a risk: `grip` is the minimum force at
which the predicted probability of slip is below it. Equations: docs/theory/friction.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from mjtactile.core.signature_checks import above, validated, within
from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation.touch_statics import shear

GRID = np.linspace(0.10, 1.30, 49)
"""Values of the friction coefficient."""
_SPACING = float(GRID[1] - GRID[0])
# diffusion of mu, 1/sqrt(s), steady and changing; rates of the mode, 1/s, to changing and back
_DRIFT = (0.02, 0.25)
_RATES = (0.02, 1.0)
_PRIOR = (0.7, 0.25)  # mean and standard deviation of mu before the first image
# probability in one image, by the utilization over mu, that some fingers report slip, that all do,
# and that all do with a growing distance (`mjtactile bench friction`)
_RATIO = (0.4, 0.55, 0.65, 0.75, 0.85, 0.95, 1.05)
_SIGNS = (
    (0.002, 0.006, 0.013, 0.015, 0.045, 0.110, 0.130),
    (0.0002, 0.001, 0.003, 0.004, 0.008, 0.080, 0.100),
    (0.00001, 0.0001, 0.0007, 0.0035, 0.024, 0.110, 0.370),
)
# minimum growth of the distance from image to image, m: constant part, and times the relative
# increase of the grip, which drags the surface of a soft object along
_GROWTH = (5e-5, 1e-3)
_USED_SD = (0.025, 0.006)  # sd of the utilization: constant part, and times 1 N over the force
_WRONG = 0.01  # probability of an image in which that model does not hold
# fraction of an image that is independent of the previous one: in a steady hold its errors last
_INDEPENDENT = 0.5
# of a sign in its first image and in further ones: a report lasts for five images, and one finger
# slips at its own utilization; no report is more evidence while the grip is loosened on purpose
_WEIGHTS = ((0.03, 0.03), (0.6, 0.0), (1.0, 0.05), (1.0, 1.0))
_TEST_WEIGHT = 0.5
# change of the shear over that of the grip, sticking and sliding; sd of it, and per change
_ANSWERS = (0.15, 0.65)
_ANSWER_SD = (0.08, 0.2)
_ANSWER_TIME = 0.15  # time constant of the mean that a change is relative to, s
_ANSWER_MIN = 0.05  # minimum relative change of the grip
_REPORT_TIME = 0.15  # duration of a slip report after the slip, s
_FORCE_MIN = 0.05  # minimum mean normal force for an update, N
_LAG = 0.15  # prediction time, s: an image, the servo and its play
_LOAD_SD = 0.06  # relative sd of load over grip: errors of the forces and of their control


NONE, SOME, ALL, CONFIRMED = range(4)
"""Signs of slip: no finger, some fingers, all fingers report it; its distance grows on all."""


class Signs(NamedTuple):
    """Evidence of one image: mean `press` and `drag`, N, utilizations of the last `_REPORT_TIME`,
    slip distances, m, sign of slip, ages of the reports, s, and relative changes of grip and shear
    (NaN: unknown). `grows`: the distance of a finger that reports slip grows."""

    press: float
    drag: float
    recent: list[float]
    distances: list[float]
    slip: int
    ages: list[float]
    harder: float
    more: float
    grows: bool = False


@dataclass(frozen=True)
class FrictionFilter:
    """Posterior of the friction coefficient.

    A controller stores it as plain values (`vars`) and restores it (`FrictionFilter(**kept)`).

    Attributes:
        weights: (2 n) Probability of each value of `GRID`, steady and changing; empty: the prior.
        press, drag: Recent mean normal force and mean shear per finger, N; 0: unknown.
        recent: Utilizations, shear over normal force, of the last `_REPORT_TIME`: slip is reported
            late.
        distances: Slip distance of each finger, m.
        slip: Sign of slip in the last image.
        ages: Time since each finger's last slip report, s.
        grows: The distance of a finger that reports slip grew in the last image.
    """

    weights: Sequence[float] = ()
    press: float = 0.0
    drag: float = 0.0
    recent: Sequence[float] = ()
    distances: Sequence[float] = ()
    slip: int = NONE
    ages: Sequence[float] = ()
    grows: bool = False

    @validated(period=above(0))
    def after(
        self, touch: Sequence[Touch], period: float, *, is_test: bool = False
    ) -> FrictionFilter:
        """Update with one image.

        Args:
            touch: Current touches.
            period: Time since the previous image, s.
            is_test: True while the grip is loosened on purpose, so that no slip is evidence.

        Returns:
            The updated filter; without a usable image only the prediction.
        """
        predicted = _transition(period) @ self._posterior()
        signs = self.signs(touch, period)
        if signs is None:
            return replace(self, weights=predicted.tolist())
        weights = predicted * np.tile(_likelihood(signs, self.slip, is_test), 2)
        follow = min(1.0, period / _ANSWER_TIME) if self.press else 1.0
        return FrictionFilter(
            (weights / weights.sum()).tolist(),
            self.press + follow * (signs.press - self.press),
            self.drag + follow * (signs.drag - self.drag),
            signs.recent,
            signs.distances,
            signs.slip,
            signs.ages,
            signs.grows,
        )

    def signs(self, touch: Sequence[Touch], period: float) -> Signs | None:
        """Return the evidence of an image; None without a known grip force."""
        press = float(np.mean([one.force_normal for one in touch]))
        drag = float(np.linalg.norm(shear(touch), axis=1).mean())
        if not (math.isfinite(drag) and press > _FORCE_MIN):
            return None
        count = max(1, round(_REPORT_TIME / period))
        recent = [*self.recent, drag / press][-count:]
        distances = [0.0 if one.slip is None else one.slip.distance for one in touch]
        states = [None if one.slip is None else one.slip.state for one in touch]
        before = self.ages or [1.0] * len(touch)
        ages = [
            0.0 if state == "slipping" else age + period
            for state, age in zip(states, before, strict=True)
        ]
        slip = slip_sign(touch)
        if slip == SOME and max(ages) < _REPORT_TIME:
            slip = ALL  # one after the other
        if min(self.press, self.drag) > 0:
            changes = press / self.press - 1, drag / self.drag - 1
        else:
            changes = math.nan, math.nan
        min_growth = _GROWTH[0] + _GROWTH[1] * np.fmax(changes[0], 0.0)
        pairs = zip(distances, self.distances, strict=False)
        growing = [new - old > min_growth for new, old in pairs]
        if slip == ALL and growing and all(growing):
            slip = CONFIRMED
        pairs = zip(states, growing, strict=False)
        grows = any(state == "slipping" and is_growing for state, is_growing in pairs)
        return Signs(press, drag, recent, distances, slip, ages, *changes, grows)

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
    """Return the steady prior, (2 n)."""
    fraction = _RATES[0] / (_RATES[0] + _RATES[1])
    return np.concatenate([(1 - fraction) * _common(), fraction * _common()])


@cache
def _common() -> Array:
    """Return the probability (n,) of each value of `GRID` for any pair of surfaces."""
    mean, sd = _PRIOR
    weights = np.exp(-0.5 * ((GRID - mean) / sd) ** 2)
    return weights / weights.sum()


@cache
def _transition(period: float) -> Array:
    """Return the probabilities (2 n, 2 n) of the next state (row) given the present one."""
    offset = GRID[:, None] - GRID[None, :]
    blocks = []
    for drift in _DRIFT:
        kernel = _kernel(offset, drift * math.sqrt(period)) * _common()[:, None]
        blocks.append(kernel / kernel.sum(axis=0))
    to_changing, to_steady = (1 - math.exp(-rate * period) for rate in _RATES)
    return np.block(
        [
            [(1 - to_changing) * blocks[0], to_steady * blocks[0]],
            [to_changing * blocks[1], (1 - to_steady) * blocks[1]],
        ]
    )


def _kernel(offset: Array, sd: float) -> Array:
    """Return a kernel of this standard deviation on the grid."""
    if sd > _SPACING:
        return np.exp(-0.5 * (offset / sd) ** 2)
    near = 0.5 * (sd / _SPACING) ** 2  # a random walk to the neighbours
    steps = np.abs(np.round(offset / _SPACING))
    return np.where(steps == 0, 1 - 2 * near, np.where(steps == 1, near, 0.0))


@validated()
def slip_sign(touch: Sequence[Touch]) -> int:
    """Return `NONE`, `SOME` or `ALL`: how many of the fingers in contact report slip."""
    states = [one.slip.state for one in touch if one.slip is not None]
    slips = [state == "slipping" for state in states if state not in ("none", "unknown")]
    return NONE if not any(slips) else ALL if all(slips) else SOME


def _likelihood(signs: Signs, before: int = NONE, is_test: bool = False) -> Array:
    """Return the likelihood (n,) of the evidence of one image after a sign of slip `before` (Eq. R2
    to R5)."""
    sd = _USED_SD[0] + _USED_SD[1] / signs.press
    beyond = (signs.recent[-1] - GRID) / sd
    possible = _WRONG + (1 - _WRONG) * _normal_cdf(2.0 - beyond)
    used = max(signs.recent)
    answer = _answer(signs.harder, signs.more, _normal_cdf((used - GRID) / sd))
    chances = [np.interp(used / GRID, _RATIO, chance) for chance in _SIGNS]
    sign = 1 - sum(chances) if signs.slip == NONE else chances[signs.slip - 1]
    weight = _WEIGHTS[signs.slip][before >= signs.slip]
    if is_test and signs.slip == NONE:
        weight = _TEST_WEIGHT
    elif signs.grows:
        weight = 1.0  # it moves now: a new event
    return (possible * answer) ** _INDEPENDENT * sign**weight


def _answer(harder: float, more: float, slides: Array) -> Array:
    """Return the likelihood (n,) of a change of the shear after a change of the grip, relative."""
    if not abs(harder) > _ANSWER_MIN:
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
