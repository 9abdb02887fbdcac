"""Derivatives of the marker heights by the shape parameters.

They are exact, approximate, or updated from a step (docs/theory/contact_shape.md, Eq. F18).
"""

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

_WORN = 8.0  # parameter change, in derivative steps, after which the Jacobian is recomputed
# fraction of a model's steps, for differences of the shapes, which have closed forms
_SMALL = 1e-5
_LITTLE = 1e-2  # the edge of an obstacle is located to a millionth of a spacing


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives by the scaled parameters at `theta` (k,). They are those of the marker `heights`
    (N, k), m, and of the membrane's `sums` (8, k) (`forward.SUMS`). If not `exact`, they suffice
    for the fit to converge, but the sums are not accurate enough to report."""

    heights: Array
    sums: Array
    theta: Array
    exact: bool

    def seen(self, data: Data) -> Array:
        """Return the Jacobian of the whitened markers of an image (n, k)."""
        return data.root @ self.heights[data.ids]

    def learnt(self, moved: Array, heights: Array, sums: Array) -> Jacobian:
        """Return the Jacobian after Broyden's update. It is the nearest one that explains the
        observed change of `heights` and `sums` by the parameter change `moved` (k,), in standard
        deviations."""
        along = moved / max(float(moved @ moved), 1e-12)
        return replace(
            self,
            heights=self.heights + np.outer(heights - self.heights @ moved, along),
            sums=self.sums + np.outer(sums - self.sums @ moved, along),
        )

    def worn(self, family: ShapeModel, theta: Array) -> bool:
        """Return True if the parameters have moved so far that the Jacobian must be recomputed."""
        return bool((np.abs(theta - self.theta) > _WORN * family.steps).any())


def learnt(slopes: Jacobian, sd: Array, at: FitState, new: FitState) -> Jacobian:
    """Return the Jacobian updated by the result of the step from `at` to `new`."""
    moved = (new.theta - at.theta) / sd
    sums = new.state.found[SUMS] - at.state.found[SUMS]
    return slopes.learnt(moved, new.heights - at.heights, sums)


def approximate_jacobian(
    forward: ForwardModel, family: ShapeModel, hint: InitialGuess, at: FitState
) -> Jacobian:
    """Compute an approximate Jacobian, accurate to 5 to 20 %, for fit steps; of the sums only the
    normal force. It takes a fifth of the time of the exact one."""
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
    """Build the shape with parameters `theta` (k,), and one shape per parameter changed by `steps`
    (k,)."""
    return family.build_each(np.vstack([theta, theta + np.diag(steps)]), hint)


def exact_jacobian(
    forward: ForwardModel, family: ShapeModel, hint: InitialGuess, at: FitState
) -> Jacobian:
    """Compute the exact Jacobian from the analytic derivatives of the membrane model. These do not
    exist for a face about to slide off its rim. Then finite differences of membrane solutions are
    used. It is zero for parameters whose changed solution did not converge."""
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
    """Compute the Jacobian by differences of membrane solutions, for parameter changes `steps`
    (k,)."""
    batch = forward.solve(_beside(family, hint, at.theta, steps)[1:], at.state)
    over = (batch.converged / (steps / family.sd))[:, None]
    heights = (forward.heights(batch.x) - at.heights) * over
    sums = (batch.found[:, SUMS] - at.state.found[SUMS]) * over
    return Jacobian(heights.T, np.where(over == 0, 0.0, sums).T, at.theta, True)
