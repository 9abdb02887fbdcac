"""Deviation of a round object from its shape model, as another quadric that touches at the same
lowest point (docs/theory/contact_shape.md, Eq. F20).

A general quadric has curvatures, a skew and a vertical curvature. The models fix the last two, and
a ball also the ratio of its curvatures. Their effect on the fit is marginalized to first order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.quasistatic.obstacles import KINDS, NUMBERS
from mjtactile.sensing.contact_shape.fit_state import Data
from mjtactile.sensing.contact_shape.forward_model import SUM_AREA, ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import place_of, principal

# Standard deviations over the larger curvature, of ellipsoids with semi-axes within a factor of
# three, distributed uniformly in their logarithm: skew at any orientation, vertical curvature and
# half the difference of the curvatures on an axis.
_SKEW, _VERTICAL, _UNEQUAL = 0.22, 0.9, 0.28
_OF_ALL = 3  # number of those that all models lack
_STEP = 1e-4  # of a deviation, relative to the larger curvature
_FLAT = 0.2  # minimum curvature, 1/m
_ELLIPSOID = KINDS["ellipsoid"][0]
_AREA_MIN = 0.2  # minimum fraction of the area that the linear deviation leaves


@dataclass(frozen=True, eq=False)
class Deviation:
    """First-order effect of the deviation on a fit.

    Attributes:
        theta: Change (k,) of the parameters of the fit, in their units.
        cov: Additional covariance (k, k) of these parameters.
        area: Change of the contact area, m^2.
        area_sd: Additional standard deviation of the contact area, m^2.
        unequal: Half the difference of the curvatures (2,) of a ball, along the axes and the
            diagonals, 1/m; zero for the other models.
        unequal_sd: Standard deviation of each, 1/m.
    """

    theta: Array
    cov: Array
    area: float
    area_sd: float
    unequal: Array
    unequal_sd: float

    def with_area(self, p: float, area: float, sd: float) -> tuple[float, float, float]:
        """Return probability, area and its standard deviation, m^2, including the deviation."""
        return p, max(area + self.area, _AREA_MIN * area), math.hypot(sd, self.area_sd)


def deviation(forward: ForwardModel, found: Fit, data: Data, noise: float) -> Deviation | None:
    """Estimate the deviation from the markers of an image. Marker variances are multiplied by
    `noise`. None: the model has no curvatures in both directions, or is close to instability."""
    if found.family.name not in ("ball", "smooth"):
        return None
    rows, steps, scale = _changed(found)
    try:
        heights, sums = forward.derivatives(found.state, (rows[:, None], None), steps)
    except InputError:
        return None
    J = found.slopes.seen(data)
    by = data.root @ (heights.T * scale)[data.ids]
    kept = found.family.kept
    loose = found.prior.precision.copy()
    loose[np.ix_(kept, kept)] = np.eye(int(kept.sum()))
    H = J.T @ J / noise + loose
    carried = -np.linalg.solve(H, J.T @ by / noise)
    left = by + J @ carried
    precision = np.eye(len(scale)) + by.T @ left / noise
    cov = np.linalg.inv(precision)
    mean = -cov @ (left.T @ found.at.residual) / noise
    sd = found.family.sd
    response = sd[:, None] * carried
    area_by = sums[:, SUM_AREA] * scale + found.slopes.sums[SUM_AREA] @ carried
    change = found.theta + response @ mean
    uneven = slice(_OF_ALL, None)
    return Deviation(
        np.clip(change, found.family.low, found.family.high) - found.theta,
        response @ cov @ response.T,
        float(area_by @ mean),
        math.sqrt(float(area_by @ cov @ area_by)),
        np.resize(scale[uneven] * mean[uneven], 2),
        math.sqrt(float((scale**2 * np.diag(cov))[uneven].sum()) / 2),
    )


def _changed(found: Fit) -> tuple[Array, Array, Array]:
    """Return the rows (1 + m, NUMBERS) of the fitted quadric and of one for each deviation, the
    steps (m,), 1/m, and the prior standard deviations (m,), 1/m."""
    theta = found.theta
    if found.family.name == "ball":
        bent, count = (theta[3], 0.0, theta[3]), 5
    else:
        bent, count = tuple(theta[3:6]), 3
    maximum = max(principal(np.array([0, 0, 0, *bent]))[0], _FLAT)
    place = place_of(theta, found.hint)
    base = np.array([*bent, 0.0, 0.0, maximum])
    change = np.zeros((5, 6))
    change[0, 3] = change[1, 4] = change[2, 5] = 1.0
    change[3, [0, 2]] = 1.0, -1.0
    change[4, 1] = 1.0
    steps = np.full(count, _STEP * maximum)
    scale = maximum * np.array([_SKEW, _SKEW, _VERTICAL, _UNEQUAL, _UNEQUAL])[:count]
    numbers = base + np.vstack([np.zeros(6), change[:count] * steps[:, None]])
    return np.array([_quadric_row(place, *each) for each in numbers]), steps, scale


def _quadric_row(
    place: Array, k_xx: float, k_xy: float, k_yy: float, g_x: float, g_y: float, vertical: float
) -> Array:
    """Return the row (NUMBERS,) of an ellipsoid with its lowest point at `place` (3,), m:
    z = x K x / 2 + z g x + vertical z^2 / 2."""
    M = np.array([[k_xx, k_xy, g_x], [k_xy, k_yy, g_y], [g_x, g_y, vertical]])
    values, axes = np.linalg.eigh(M)
    values = np.maximum(values, _FLAT)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    center = axes @ (axes[2] / values)
    sizes = np.sqrt(center[2] / values)
    row = np.zeros(NUMBERS)
    row[0] = _ELLIPSOID
    row[1:4] = sizes
    row[4:13] = axes.ravel()
    row[13:16] = place + center
    row[18], row[19] = 2 * sizes.min(), sizes.sum()
    return row
