"""What the looks at a press have in common: a body's own numbers, which it keeps while it goes and
turns (docs/theory/contact_shape.md, Eq. F19).

A ball's curvature is the same in each of them, and so is a face's radius; a family that needs
another one at each depth is the wrong one. Each look tells mean and precision of these numbers with
the place left free. What a film has wrong is about the same in all looks: it is no noise between
them, so that numbers are compared as precisely as markers are seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.fit_state import Prior
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel


@dataclass(frozen=True, eq=False)
class ShapeFilter:
    """What looks have told of the numbers that a body keeps (`ShapeModel.kept`), over their sd:
    `precision` (m, m), and that times their mean, `told` (m,); and `drift`, the sum of squares by
    which they did not stay the same."""

    precision: Array
    told: Array
    drift: float = 0.0

    @classmethod
    def of(cls, family: ShapeModel) -> ShapeFilter:
        """Before any look: nothing."""
        count = int(family.kept.sum())
        return cls(np.zeros((count, count)), np.zeros(count))

    def with_observation(self, fit: Fit) -> ShapeFilter:
        """With one look more.

        Args:
            fit: The body as the look has it.

        Returns:
            What is known now.
        """
        seen, told = _alone(fit)
        own = np.eye(len(told)) + seen @ _own_wrong(fit)
        seen = np.linalg.solve(own, seen)
        told = np.linalg.solve(own, told)
        drift = self.drift + self._off(seen, told)
        return ShapeFilter(self.precision + seen, self.told + told, drift)

    def _off(self, seen: Array, told: Array) -> float:
        """Square of how far a look that has `seen` (m, m) precisely what it has `told` (m,) is from
        those before, over the covariance of that; nothing of what either does not see."""
        if not self.precision.any():
            return 0.0
        tiny = _UNSEEN * np.eye(len(told))
        known = np.linalg.inv(self.precision + tiny)
        off = told - seen @ known @ self.told
        return float(off @ np.linalg.solve(seen + seen @ known @ seen + tiny, off))

    def prior(self, fit: Fit, noise: float, hint: InitialGuess) -> Prior:
        """What is believed of all numbers in the next look.

        Args:
            fit: The body as the last look has it.
            noise: Of the markers' variances, what was left of them in it.
            hint: What the numbers count from in the next.

        Returns:
            Where it stands: about as in `fit`; what it keeps: as all looks have it, but for what
            the film has wrong.
        """
        family = fit.family
        kept = family.kept
        free = ~kept
        mean = family.rebased(fit.theta, fit.hint, hint) / family.sd
        believed = (family.mean / family.sd)[kept]
        known = np.linalg.inv(self.precision / noise + np.eye(len(believed)))
        mean[kept] = known @ (self.told / noise + believed)
        stood = np.linalg.inv(fit.precision_with(noise))[np.ix_(free, free)]
        cov = np.zeros((len(mean), len(mean)))
        cov[np.ix_(free, free)] = stood + np.diag((family.loose / family.sd)[free] ** 2)
        cov[np.ix_(kept, kept)] = known + _own_wrong(fit)
        return Prior(mean, np.linalg.inv(cov))


_UNSEEN = 1e-6  # of a family's own precision
_BY_NODE = 1.5  # of a curvature or size, over the nodes that touch: what a film of so few has wrong


def _alone(fit: Fit) -> tuple[Array, Array]:
    """Precision (m, m) of the kept numbers over their sd, by one image alone, and that times their
    mean (m,): the fit without its prior of them, over all places where the body may stand."""
    kept = fit.family.kept
    free = ~kept
    t = fit.theta / fit.family.sd
    prior = fit.prior
    noise = max(fit.misfit, 1.0)
    image = fit.curvature / noise
    # where the fit ends, what the prior pulls is what the image does
    told = image @ t + prior.precision @ (t - prior.mean) / noise
    stand = prior.precision[np.ix_(free, free)]
    place = np.linalg.solve(
        image[np.ix_(free, free)] + stand,
        np.column_stack([image[np.ix_(free, kept)], told[free] + stand @ prior.mean[free]]),
    )
    through = image[np.ix_(kept, free)] @ place
    return image[np.ix_(kept, kept)] - through[:, :-1], told[kept] - through[:, -1]


def _own_wrong(fit: Fit) -> Array:
    """Variance (m, m) of the kept numbers over their sd, that the film has wrong in one look, and
    otherwise in another: the more, the fewer of its nodes touch."""
    share = np.hypot(fit.family.share, _BY_NODE / touching(fit))
    return np.diag((share * fit.theta / fit.family.sd)[fit.family.kept] ** 2)


def touching(fit: Fit) -> float:
    """How many of the film's nodes touch a body; of several bodies, in the mean."""
    nodes = int((fit.state.contact_forces > 0).sum())
    return max(nodes / max(len(fit.family.parts), 1), 1.0)
