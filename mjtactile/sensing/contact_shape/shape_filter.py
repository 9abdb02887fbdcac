"""Filter of a shape's constant parameters over a contact episode.

These parameters do not change while the shape moves and rotates (docs/theory/contact_shape.md, Eq.
F19). A ball's curvature is the same in all images, and so is a face's radius. A model that needs
another value at each depth is the wrong one. Each evaluation gives mean and precision of these
parameters, marginalized over the pose. Errors of the membrane model are about the same in all
evaluations. They are not noise between them, so the parameters are compared with the precision of
the markers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.fit_state import Prior
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel


@dataclass(frozen=True, eq=False)
class ShapeFilter:
    """Information on the constant parameters (`ShapeModel.kept`), in units of their standard
    deviation. `precision` (m, m) is their precision, `information` (m,) the precision times the
    mean. `coarse` is the mesh ratio (`ContactShapeSettings.mesh_ratio`). `drift` is the sum of
    squares of their changes, with `freedom` degrees of freedom. `growth` is the smallest relative
    increase of a parameter at the last evaluation over the earlier ones, and its variance."""

    precision: Array
    information: Array
    coarse: float = 1.0
    drift: float = 0.0
    freedom: float = 0.0
    growth: tuple[float, float] = (0.0, math.inf)

    @classmethod
    def of(cls, family: ShapeModel, coarse: float = 1.0) -> ShapeFilter:
        """Create the filter before any evaluation, without information."""
        count = int(family.kept.sum())
        return cls(np.zeros((count, count)), np.zeros(count), coarse)

    @property
    def variance_factor(self) -> float:
        """Ratio of the observed to the expected squared changes, at least 1 (Birge ratio)."""
        return max(1.0, self.drift / max(self.freedom, 1.0))

    def with_observation(self, fit: Fit) -> ShapeFilter:
        """Return the filter updated by one evaluation."""
        seen, information = _information_of(fit)
        known = np.linalg.inv(self.precision + _UNSEEN * np.eye(len(information)))
        growth = self._growth(known, seen, information)
        inflation = np.eye(len(information)) + seen @ _model_error_variance(fit, self.coarse)
        inflated = np.linalg.solve(inflation, np.hstack([seen, information[:, None]]))
        seen, information = inflated[:, :-1], inflated[:, -1]
        drift = self.drift + _heavy_tailed(
            self._squared_distance(known, seen, information), len(information)
        )
        freedom = self.freedom + (len(information) if self.precision.any() else 0)
        precision = self.precision + seen
        total = self.information + information
        return ShapeFilter(precision, total, self.coarse, drift, freedom, growth)

    def _growth(self, known: Array, seen: Array, information: Array) -> tuple[float, float]:
        """Return `growth` for an evaluation with precision `seen` (m, m) and information vector
        `information` (m,). `known` (m, m) is the covariance before."""
        if not self.precision.any():
            return 0.0, math.inf
        new = np.linalg.inv(seen + _UNSEEN * np.eye(len(information)))
        before = np.maximum(known @ self.information, _UNSEEN)
        relative = (new @ information - before) / before
        side = int(relative.argmin())
        return float(relative[side]), float((known + new)[side, side] / before[side] ** 2)

    def _squared_distance(self, known: Array, seen: Array, information: Array) -> float:
        """Return the squared Mahalanobis distance of an evaluation from the earlier ones. The
        evaluation has precision `seen` (m, m) and information vector `information` (m,). `known`
        (m, m) is the covariance before. Unobserved directions do not count."""
        if not self.precision.any():
            return 0.0
        tiny = _UNSEEN * np.eye(len(information))
        unexplained = information - seen @ known @ self.information
        # singular to rounding where one direction is known a million times better than another
        precision = np.linalg.pinv(seen + seen @ known @ seen + tiny, hermitian=True)
        return float(unexplained @ precision @ unexplained)

    def prior(self, fit: Fit, noise: float, hint: InitialGuess) -> Prior:
        """Return the prior of all parameters for the next evaluation. The pose is near that of
        `fit`, relative to the guess `hint`. The constant parameters come from all evaluations, with
        the membrane model error added. `noise` is the factor on the marker variances."""
        family = fit.family
        kept = family.kept
        free = ~kept
        mean = family.rebased(fit.theta, fit.hint, hint) / family.sd
        scaled_mean = (family.mean / family.sd)[kept]
        known = np.linalg.inv(self.precision / noise + np.eye(len(scaled_mean)))
        mean[kept] = known @ (self.information / noise + scaled_mean)
        blocks = family.blocks
        stood = np.linalg.inv(fit.precision_with(noise))[blocks["ff"]]
        cov = np.zeros((len(mean), len(mean)))
        cov[blocks["ff"]] = stood + np.diag((family.loose / family.sd)[free] ** 2)
        cov[blocks["kk"]] = known + _model_error_variance(fit, self.coarse)
        return Prior(mean, np.linalg.inv(cov))


_TAIL = 6.0  # degrees of freedom of the distribution of changes
_UNSEEN = 1e-6  # as a fraction of a family's own precision
_BY_NODE = 1.5  # relative model error of a curvature or size, times the number of touching nodes


def _heavy_tailed(square: float, count: int) -> float:
    """Return the penalty of a change of `count` parameters with the squared Mahalanobis distance
    `square`: -2 times the log density of a multivariate Student t distribution over that of no
    change."""
    return (_TAIL + count) * math.log1p(square / _TAIL)


def _information_of(fit: Fit) -> tuple[Array, Array]:
    """Return precision (m, m) and information vector (m,) of the constant parameters from one
    image. They are scaled by the standard deviations, exclude the prior of these parameters, and
    are marginalized over the pose."""
    kept = fit.family.kept
    free = ~kept
    t = fit.theta / fit.family.sd
    prior = fit.prior
    noise = max(fit.misfit, 1.0)
    image = fit.curvature / noise
    # that of the image alone: a fit may end before its prior and the image balance
    information = image @ t - fit.gradient / noise
    blocks = fit.family.blocks
    stand = prior.precision[blocks["ff"]]
    known = information[free] + stand @ prior.mean[free]
    sides = np.hstack([image[blocks["fk"]], known[:, None]])
    through = image[blocks["kf"]] @ np.linalg.solve(image[blocks["ff"]] + stand, sides)
    return image[blocks["kk"]] - through[:, :-1], information[kept] - through[:, -1]


def _model_error_variance(fit: Fit, coarse: float) -> Array:
    """Return the variance (m, m) of the scaled constant parameters from membrane model errors. It
    covers errors that differ between evaluations. It grows as fewer nodes touch, and with the mesh
    ratio `coarse`: an error of the position of a rim with the spacing, one of the sag between
    vertices with its square."""
    by_node = _BY_NODE * np.where(fit.family.curved, coarse**2, coarse)
    fraction = np.hypot(fit.family.share, by_node / touching(fit))
    return np.diag((fraction * fit.theta / fit.family.sd)[fit.family.kept] ** 2)


def touching(fit: Fit) -> float:
    """Return the number of membrane nodes that touch the shape; for several parts, their mean."""
    nodes = np.count_nonzero(fit.state.contact_forces > 0)
    return max(nodes / max(len(fit.family.parts), 1), 1.0)
