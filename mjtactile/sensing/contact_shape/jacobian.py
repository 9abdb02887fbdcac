"""How markers' heights go with a body's numbers: exactly, nearly, or as a step has shown
(docs/theory/contact_shape.md, Eq. F18)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.quasistatic import Obstacle
from mjtactile.sensing.contact_shape.fit_state import Data, FitState
from mjtactile.sensing.contact_shape.forward_model import SUMS, ForwardModel
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel

_WORN = 8.0  # steps of a derivative that a number may go before it is taken anew
# of a family's steps: bodies' own differences, which are closed forms
_SMALL = 1e-5
_LITTLE = 1e-2  # where a body's edge is found to a millionth of a spacing


@dataclass(frozen=True, eq=False)
class Jacobian:
    """By each number over its sd: `heights` (N, k) m of the markers and `sums` (8, k) of the film
    (`forward.SUMS`); found where the numbers were `theta` (k,). What is not `exact` leads a fit to
    its end as well, and says too little of the sums to be told."""

    heights: Array
    sums: Array
    theta: Array
    exact: bool

    def seen(self, data: Data) -> Array:
        """Of an image's whitened markers (n, k)."""
        return data.root @ self.heights[data.ids]

    def learnt(self, moved: Array, heights: Array, sums: Array) -> Jacobian:
        """Broyden's: those nearest these that explain that numbers `moved` (k,) over their sd
        changed heights and sums so."""
        along = moved / max(float(moved @ moved), 1e-12)
        return replace(
            self,
            heights=self.heights + np.outer(heights - self.heights @ moved, along),
            sums=self.sums + np.outer(sums - self.sums @ moved, along),
        )

    def worn(self, family: ShapeModel, theta: Array) -> bool:
        """Whether the numbers have gone so far that they are to be found anew."""
        return bool((np.abs(theta - self.theta) > _WORN * family.steps).any())


def learnt(slopes: Jacobian, sd: Array, at: FitState, new: FitState) -> Jacobian:
    """Slopes that say of the step from `at` to `new` what came of it."""
    moved = (new.theta - at.theta) / sd
    sums = new.state.found[SUMS] - at.state.found[SUMS]
    return slopes.learnt(moved, new.heights - at.heights, sums)


def approximate_jacobian(
    forward: ForwardModel, family: ShapeModel, hint: InitialGuess, at: FitState
) -> Jacobian:
    """Slopes at a body for a fifth of the time of exact ones, within 5 to 20 %: for steps.

    Args:
        forward: The film.
        family: The family.
        hint: What its numbers count from.
        at: Where.

    Returns:
        The slopes; of the sums, that of the normal force alone.
    """
    steps = _LITTLE * family.steps
    try:
        heights, force = forward.answers(at.state, _beside(family, hint, at.theta, steps), steps)
    except InputError:
        return exact_jacobian(forward, family, hint, at)
    sums = np.zeros((len(SUMS), len(force)))
    sums[2] = -force * family.sd
    return Jacobian(heights.T * family.sd, sums, at.theta, False)


def _beside(
    family: ShapeModel, hint: InitialGuess, theta: Array, steps: Array
) -> list[tuple[Obstacle, ...]]:
    """Bodies of a family: one with numbers `theta` (k,), and those that are one of `steps` (k,)
    further."""
    return family.build_each(np.vstack([theta, theta + np.diag(steps)]), hint)


def exact_jacobian(
    forward: ForwardModel, family: ShapeModel, hint: InitialGuess, at: FitState
) -> Jacobian:
    """Slopes at a body: the film's own derivatives, or, where it has none (a face that is about to
    slide off its rim), differences of films that start from the one on it.

    Args:
        forward: The film.
        family: The family.
        hint: What its numbers count from.
        at: Where.

    Returns:
        The slopes; nothing of a number by which no film rests.
    """
    sides = np.where(at.theta + family.steps > family.high, -1.0, 1.0)
    steps = sides * family.steps
    little = _SMALL * steps
    try:
        heights, sums = forward.derivatives(
            at.state, _beside(family, hint, at.theta, little), little
        )
    except InputError:
        return _by_differences(forward, family, hint, at, steps)
    return Jacobian(heights.T * family.sd, sums.T * family.sd, at.theta, True)


def _by_differences(
    forward: ForwardModel, family: ShapeModel, hint: InitialGuess, at: FitState, steps: Array
) -> Jacobian:
    """The same by films on bodies with numbers `steps` (k,) further on."""
    batch = forward.solve(_beside(family, hint, at.theta, steps)[1:], at.state)
    over = (batch.converged / (steps / family.sd))[:, None]
    heights = (forward.heights(batch.x) - at.heights) * over
    sums = (batch.found[:, SUMS] - at.state.found[SUMS]) * over
    return Jacobian(heights.T, np.where(over == 0, 0.0, sums).T, at.theta, True)
