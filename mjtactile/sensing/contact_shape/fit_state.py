"""Image data, prior of the shape parameters, and fit state.

See docs/theory/contact_shape.md, Eq. F18.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Touch
from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.forward_model import ForwardModel, converged
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel
from mjtactile.sensing.settings import ContactShapeSettings


@dataclass(frozen=True, eq=False)
class Data:
    """Data of one image: marker heights, their noise, and the normal force. `heights` (n,), m, are
    those of the markers `ids` (n,), relative to the membrane model. `root` (n, n) whitens their
    noise. `force`, N, is the estimated normal force."""

    ids: NDArray[np.int64]
    heights: Array
    root: Array
    force: float

    def raised(self, by: Array) -> Data:
        """Return the data for another membrane model, whose markers at rest are `by` (N,) m
        higher."""
        return replace(self, heights=self.heights + by[self.ids])

    @classmethod
    def of(
        cls,
        touch: Touch,
        raised: Array,
        by_gas: Array,
        s: ContactShapeSettings,
        drift: tuple[float, float],
    ) -> Data:
        """Build the data of a touch. `raised` (N,), m, is the height of the markers at rest above
        the model's, `by_gas` (N,), m, the derivative of the marker heights by the relative gas
        amount. `drift` holds the standard deviations of that amount and of the camera displacement,
        m, since the rest reference."""
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
    """Gaussian prior of a model's parameters, scaled by the model's standard deviations: `mean`
    (k,) and `precision` (k, k)."""

    mean: Array
    precision: Array

    @classmethod
    def of(cls, family: ShapeModel, start: Array) -> Prior:
        """Before any image, where a fit begins at `start` (k,): no direction is likelier than
        another."""
        turns = [name in ("direction", "angle") for name in family.names]
        return cls(np.where(turns, start, family.mean) / family.sd, np.eye(len(family.sd)))

    def cost(self, t: Array) -> float:
        """Return the cost of scaled parameters `t` (k,)."""
        off = t - self.mean
        return float(off @ self.precision @ off)


@dataclass(frozen=True, eq=False)
class FitState:
    """State of a fit: parameters, membrane solution, and residual. `theta` are the parameters,
    `heights` (N,), m, the marker heights of the membrane solution. `residual` is whitened; `cost`
    is its cost."""

    theta: Array
    state: MembraneSolution
    heights: Array
    residual: Array
    cost: float


def begin(
    forward: ForwardModel,
    family: ShapeModel,
    hint: InitialGuess,
    theta: Array,
    data: Data,
    prior: Prior,
    state: MembraneSolution | None,
) -> FitState | None:
    """Solve the membrane on a shape with parameters `theta`, starting from `state` (None: from
    rest). Return the start state of a fit; None: the solver did not converge."""
    theta = np.clip(theta, family.low, family.high)
    batch = forward.solve([family.build(theta, hint)], state)
    if not converged(batch):
        return None
    return standing(forward, family, theta, data, prior, batch[0])


def standing(
    forward: ForwardModel,
    family: ShapeModel,
    theta: Array,
    data: Data,
    prior: Prior,
    state: MembraneSolution,
) -> FitState:
    """Return the fit state of a converged membrane solution; arguments as for `begin`."""
    heights = forward.heights(state.x[None])[0]
    residual = data.residual(heights)
    cost = float(residual @ residual) + prior.cost(theta / family.sd)
    return FitState(theta, state, heights, residual, cost)
