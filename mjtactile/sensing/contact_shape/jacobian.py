"""Derivatives of the marker heights by the shape parameters: exact, approximate, or updated from a
step (docs/theory/contact_shape.md, Eq. F18)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Problem
from mjtactile.sensing.contact_shape.forward_model import SUMS, ShapeRows
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

    def updated(self, sd: Array, at: FitState, new: FitState) -> Jacobian:
        """Return the Jacobian after Broyden's update: the nearest one that explains the result of
        the step from `at` to `new`."""
        moved = (new.theta - at.theta) / sd
        along = moved / max(float(moved @ moved), 1e-12)
        heights = new.heights - at.heights - self.heights @ moved
        sums = new.state.found[SUMS] - at.state.found[SUMS] - self.sums @ moved
        return replace(
            self,
            heights=self.heights + np.outer(heights, along),
            sums=self.sums + np.outer(sums, along),
        )

    def worn(self, family: ShapeModel, theta: Array) -> bool:
        """Return True if the parameters have moved so far that the Jacobian must be recomputed."""
        return bool((np.abs(theta - self.theta) > _WORN * family.steps).any())


def approximate_jacobian(problem: Problem, at: FitState) -> Jacobian:
    """Compute an approximate Jacobian, accurate to 5 to 20 %, for fit steps; of the sums only the
    normal force. It takes a fifth of the time of the exact one."""
    family = problem.family
    steps = _LITTLE * family.steps
    shapes = _changed_shapes(problem, at.theta, steps)
    try:
        heights, force = problem.forward.answers(at.state, shapes, steps)
    except InputError:
        return exact_jacobian(problem, at)
    sums = np.zeros((len(SUMS), len(force)))
    sums[2] = -force * family.sd
    return Jacobian(heights.T * family.sd, sums, at.theta, False)


def _changed_shapes(problem: Problem, theta: Array, steps: Array) -> ShapeRows:
    """Build the shape with parameters `theta` (k,), and one shape per parameter changed by `steps`
    (k,)."""
    return problem.family.rows(np.vstack([theta, theta + np.diag(steps)]), problem.hint)


def exact_jacobian(problem: Problem, at: FitState) -> Jacobian:
    """Compute the exact Jacobian from the analytic derivatives of the membrane model. These do not
    exist for a face about to slide off its rim. Then finite differences of membrane solutions are
    used. It is zero for parameters whose changed solution did not converge."""
    family = problem.family
    sides = np.where(at.theta + family.steps > family.high, -1.0, 1.0)
    steps = sides * family.steps
    little = _SMALL * steps
    shapes = _changed_shapes(problem, at.theta, little)
    try:
        heights, sums = problem.forward.derivatives(at.state, shapes, little)
    except InputError:
        return _by_differences(problem, at, steps)
    return Jacobian(heights.T * family.sd, sums.T * family.sd, at.theta, True)


def _by_differences(problem: Problem, at: FitState, steps: Array) -> Jacobian:
    """Compute the Jacobian by differences of membrane solutions, for parameter changes `steps`
    (k,)."""
    heights = np.zeros((len(at.heights), len(steps)))
    sums = np.zeros((len(SUMS), len(steps)))
    shapes, pool = _changed_shapes(problem, at.theta, steps)
    for k in range(len(steps)):
        changed = problem.forward.solve((shapes[k + 1 : k + 2], pool), at.state, problem.data.shear)
        if changed is None:
            continue
        over = problem.family.sd[k] / steps[k]
        heights[:, k] = (problem.forward.heights(changed.x[None])[0] - at.heights) * over
        sums[:, k] = (changed.found[SUMS] - at.state.found[SUMS]) * over
    return Jacobian(heights, sums, at.theta, True)
