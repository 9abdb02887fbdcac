"""One image's data, what is believed of a body's numbers, and the film on a body
(docs/theory/contact_shape.md, Eq. F18)."""

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
        cls,
        touch: Touch,
        raised: Array,
        by_gas: Array,
        s: ContactShapeSettings,
        drift: tuple[float, float],
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
    def of(cls, family: ShapeModel, start: Array) -> Prior:
        """Before any image, where a fit begins at `start` (k,): no direction is likelier than
        another."""
        turns = [name in ("direction", "angle") for name in family.names]
        return cls(np.where(turns, start, family.mean) / family.sd, np.eye(len(family.sd)))

    def cost(self, t: Array) -> float:
        """Of numbers `t` (k,) over their sd."""
        off = t - self.mean
        return float(off @ self.precision @ off)


@dataclass(frozen=True, eq=False)
class FitState:
    """Where a fit stands: the numbers `theta`, the film on them, its markers' `heights` (N,) m, the
    whitened `residual`, and the `cost`."""

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
    return standing(forward, family, theta, data, prior, batch[0])


def standing(
    forward: ForwardModel,
    family: ShapeModel,
    theta: Array,
    data: Data,
    prior: Prior,
    state: MembraneSolution,
) -> FitState:
    """Where a fit stands whose film has come to rest already; arguments as of `begin`."""
    heights = forward.heights(state.x[None])[0]
    residual = data.residual(heights)
    cost = float(residual @ residual) + prior.cost(theta / family.sd)
    return FitState(theta, state, heights, residual, cost)
