"""Image data, prior of the shape parameters, and state of a fit (docs/theory/contact_shape.md, Eq.
F18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Touch
from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel
from mjtactile.sensing.settings import ContactShapeSettings


@dataclass(frozen=True, eq=False)
class Data:
    """Data of one image: marker heights, their noise, and the force. `heights` (n,), m, are those
    of the markers `ids` (n,), relative to the membrane model. `root` (n, n) whitens their noise.
    `force`, N, is the estimated normal force, `shear` (2,), N, the in-plane one (None: unknown)."""

    ids: NDArray[np.int64]
    heights: Array
    root: Array
    force: float
    shear: Array | None

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
        markers = touch.markers
        assert markers is not None
        sd = np.sqrt(markers.cov_p[:, 2, 2] + s.membrane_sd**2)
        common = np.empty((len(sd), 2))
        common[:, 0], common[:, 1] = drift[0] * by_gas[markers.ids], drift[1]
        heights = markers.p_SM[:, 2] - raised[markers.ids]
        shear = None if touch.traction is None else touch.traction.wrench[:2]
        return cls(markers.ids, heights, _whitening(sd, common), touch.force_normal, shear)

    def residual(self, heights: Array) -> Array:
        """Return the whitened residual (n,) of markers predicted at `heights` (N,), m."""
        return self.root @ (heights[self.ids] - self.heights)


def _whitening(sd: Array, common: Array) -> Array:
    """Return a square root (n, n) of the inverse of a covariance. It is diag(`sd`^2) + C C'. C is
    `common` (n, m)."""
    scaled = common / sd[:, None]
    values, directions = np.linalg.eigh(scaled.T @ scaled)
    less = (1 / np.sqrt(1 + values) - 1) / np.maximum(values, 1e-12)
    root = (scaled @ (directions * less @ directions.T)) @ (scaled.T / sd)
    root.flat[:: len(sd) + 1] += 1 / sd
    return root


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian prior of a model's parameters, scaled by the model's standard deviations: `mean`
    (k,) and `precision` (k, k)."""

    mean: Array
    precision: Array

    @classmethod
    def of(cls, family: ShapeModel, start: Array) -> Prior:
        """Create the prior before any image. A fit starts at `start` (k,), and all directions are
        equally likely."""
        turns = [name in ("direction", "angle") for name in family.names]
        return cls(np.where(turns, start, family.mean) / family.sd, np.eye(len(family.sd)))

    def cost(self, t: Array) -> float:
        """Return the cost of scaled parameters `t` (k,)."""
        deviation = t - self.mean
        return float(deviation @ self.precision @ deviation)


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


@dataclass(frozen=True, eq=False)
class Problem:
    """Fit of one shape model to one image: membrane model `forward`, initial guess `hint` that the
    parameters of `family` are relative to, image `data`, and `prior` of the parameters."""

    forward: ForwardModel
    family: ShapeModel
    hint: InitialGuess
    data: Data
    prior: Prior

    def solve(self, theta: Array, start: MembraneSolution | None) -> MembraneSolution | None:
        """Solve the membrane on the shape with parameters `theta`, starting from `start` (None:
        from rest); None: the solver did not converge."""
        return self.forward.solve(self.family.rows(theta[None], self.hint), start, self.data.shear)

    def clip(self, theta: Array) -> Array:
        """Return the parameters within their bounds."""
        return np.clip(theta, self.family.low, self.family.high)

    def fit_state(self, theta: Array, start: MembraneSolution | None) -> FitState | None:
        """Return the fit state with parameters `theta`, solved from `start` as in `solve`."""
        theta = self.clip(theta)
        state = self.solve(theta, start)
        return None if state is None else self.state(theta, state)

    def state(self, theta: Array, solution: MembraneSolution) -> FitState:
        """Return the fit state of a converged membrane solution."""
        heights = self.forward.heights(solution.x[None])[0]
        residual = self.data.residual(heights)
        cost = float(residual @ residual) + self.prior.cost(theta / self.family.sd)
        return FitState(theta, solution, heights, residual, cost)
