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

import numpy as np

from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation.touch_statics import shear

GRID = np.linspace(0.10, 1.30, 49)
"""Values of the friction coefficient."""
_SPACING = float(GRID[1] - GRID[0])
# diffusion of mu, 1/sqrt(s), steady and changing; rates of the mode, 1/s, to changing and back
_DRIFT = (0.02, 0.5)
_RATES = (0.01, 1.0)
_PRIOR = (0.75, 0.3)  # mean and standard deviation of mu before the first image
# P(sign | sticking), P(sign | sliding) of one image; signs: no finger, some, all report slip
_SIGNS = np.array([[0.990, 0.009, 0.001], [0.35, 0.25, 0.40]])
_USED_SD = (0.03, 0.012)  # sd of the utilization: constant part, and times 1 N over the force
_WRONG = 0.01  # probability of an image in which that model does not hold
_INDEPENDENT = 0.5  # independent images per image: successive errors are correlated
_ANSWER_SD = 0.04  # sd of the relative change of the shear within `_ANSWER_TIME`
_ANSWER_TIME = 0.15  # time constant of the mean that a change is relative to, s
_ANSWER_MIN = 0.05  # minimum relative change of the grip
_FORCE_MIN = 0.05  # minimum mean normal force for an update, N
_LAG = 0.25  # prediction time, s: an image, the servo and its play
_LOAD_SD = 0.06  # relative sd of load over grip: errors of the forces and of their control


@dataclass(frozen=True)
class FrictionFilter:
    """Posterior of the friction coefficient.

    A controller stores it as plain values (`vars`) and restores it (`FrictionFilter(**kept)`).

    Attributes:
        weights: (2 n) Probability of each value of `GRID`, steady and changing; empty: the prior.
        press, drag: Recent mean normal force and mean shear per finger, N; 0: unknown.
    """

    weights: Sequence[float] = ()
    press: float = 0.0
    drag: float = 0.0

    def after(self, touch: Sequence[Touch], period: float) -> FrictionFilter:
        """Update with one image.

        Args:
            touch: Current touches.
            period: Time since the previous image, s.

        Returns:
            The updated filter.
        """
        predicted = _transition(period) @ self._posterior()
        press = float(np.mean([one.force_normal for one in touch]))
        drag = float(np.linalg.norm(shear(touch), axis=1).mean())
        if not (math.isfinite(press) and math.isfinite(drag) and press > _FORCE_MIN):
            return replace(self, weights=predicted.tolist())
        slides, evidence = _utilization(drag / press, press)
        sign = _SIGNS[:, _sign(touch)]
        evidence = evidence * (sign[0] + (sign[1] - sign[0]) * slides)
        if self.press > 0 and self.drag > 0:
            evidence = evidence * _answer(press / self.press - 1, drag / self.drag - 1, slides)
        weights = predicted * np.tile(evidence**_INDEPENDENT, 2)
        follow = min(1.0, period / _ANSWER_TIME) if self.press else 1.0
        return FrictionFilter(
            (weights / weights.sum()).tolist(),
            self.press + follow * (press - self.press),
            self.drag + follow * (drag - self.drag),
        )

    def density(self) -> Array:
        """Return the probability (n,) of each value of `GRID`."""
        return self._posterior().reshape(2, -1).sum(axis=0)

    def quantile(self, probability: float) -> float:
        """Return the coefficient that the true one is below with this probability."""
        return float(np.interp(probability, np.cumsum(self.density()), GRID))

    def utilization(self, risk: float) -> float:
        """Return the maximum load over grip force at which the probability of slip is `risk`.

        It holds for the time at which a command acts: the posterior is predicted by the lag of
        sensor and jaws.
        """
        ahead = (_transition(_LAG) @ self._posterior()).reshape(2, -1).sum(axis=0)
        return float(np.interp(risk, np.maximum.accumulate(_slip_given() @ ahead), GRID))

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
    mean, sd = _PRIOR
    weights = np.exp(-0.5 * ((GRID - mean) / sd) ** 2)
    share = _RATES[0] / (_RATES[0] + _RATES[1])
    both = np.concatenate([(1 - share) * weights, share * weights])
    return both / both.sum()


@cache
def _transition(period: float) -> Array:
    """Return the probabilities (2 n, 2 n) of the next state (row) given the present one."""
    offset = GRID[:, None] - GRID[None, :]
    blocks = []
    for drift in _DRIFT:
        sd = math.sqrt(drift**2 * period + (0.3 * _SPACING) ** 2 * period)
        # exact for a narrow kernel as well: the grid's variance of a step to the neighbours
        kernel = _kernel(offset, sd)
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


def _utilization(used: float, press: float) -> tuple[Array, Array]:
    """Return P(sliding | mu) and the likelihood of this utilization, each (n,)."""
    sd = _USED_SD[0] + _USED_SD[1] / press
    beyond = (used - GRID) / sd
    return _normal_cdf(beyond), _WRONG + (1 - _WRONG) * _normal_cdf(0.5 - beyond)


def _sign(touch: Sequence[Touch]) -> int:
    """Return 0, 1 or 2: no finger, some fingers, all fingers report slip."""
    slips = [one.slip is not None and one.slip.state == "slipping" for one in touch]
    return 2 if all(slips) else int(any(slips))


def _answer(harder: float, more: float, slides: Array) -> Array:
    """Return the likelihood (n,) of a change of the shear after a change of the grip, relative."""
    if abs(harder) < _ANSWER_MIN:
        return np.ones_like(slides)
    sticking, sliding = (
        0.1 + math.exp(-0.5 * ((more - share * harder) / _ANSWER_SD) ** 2) for share in (0, 1)
    )
    return sticking + (sliding - sticking) * slides


@cache
def _slip_given() -> Array:
    """Return P(slip) for each load over grip of the grid (row) and each coefficient (column)."""
    ratio = GRID[:, None]
    return _normal_cdf((ratio - GRID[None, :]) / (_LOAD_SD * ratio))
