"""Slopes of the membrane at its markers, as data for the inverse (docs/theory/membrane_inverse.md,
Eq. F11).

A marker is a circle in the membrane surface, so its ellipse gives the slopes there. Markers far
apart see a flat face only from its rim. Their slopes distinguish it from a ball that indents
deeper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core import geometry
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.spline_fem import SplineMembrane
from mjtactile.sensing.settings import InverseSettings


class MarkerSlopes:
    """Slopes (dz/dx, dz/dy) of one membrane at its markers. The marker positions (N, 3), m, are
    those of the mounted flat membrane. `distance`, m, is that of the camera."""

    def __init__(
        self, membrane: SplineMembrane, p_SM: Array, distance: float, settings: InverseSettings
    ):
        self._settings = settings
        parametric = membrane.parametric(p_SM[:, :2])
        self._along_x, self._along_y = membrane.slopes(parametric)
        self._turns = None if membrane.design.frame.outline is None else membrane.turns(parametric)
        self._behind = np.array([0.0, 0.0, distance])

    def off(self, markers: Markers, c: Array) -> Array:
        """Return the measured minus modeled slopes (m, 2) for coefficients `c` (3, n), m. They are
        NaN for a marker without a normal."""
        g1, g2 = self._tangents(c, markers.ids)
        x1, y1, z1 = g1.T
        x2, y2, z2 = g2.T
        # of the normal g1 x g2: x and y, negative, over its z
        by_z = 1 / (x1 * y2 - y1 * x2)
        slopes = np.stack([z1 * y2 - y1 * z2, x1 * z2 - z1 * x2], axis=1) * by_z[:, None]
        return geometry.slope_from_normal(markers.n_S) - slopes

    def weights(self, markers: Markers, c: Array) -> Array:
        """Return the inverse standard deviation of the measured slopes (m,); 0 for unusable
        ones."""
        outward = geometry.cross(*self._tangents(c, markers.ids))
        n = outward / np.linalg.norm(outward, axis=1)[:, None]
        p_CM = markers.p_SM + self._behind
        s = self._settings
        sd = np.hypot(s.slope_model_sd, slope_sd(n, p_CM, markers.cov_p[:, 2, 2]))
        residual = np.abs(self.off(markers, c)).max(axis=1)
        is_used = (sd < s.slope_sd_max) & (residual < s.slope_off_max)  # False for NaN
        return np.where(is_used, 1 / sd, 0.0)

    def rows(self, c: Array, ids: NDArray[np.int64]) -> Array:
        """Return the derivatives (2, m, 2, 3) of the slopes by the membrane's derivatives at the
        markers. These are derivatives by the parametric coordinates, through the tangents g1 =
        dx/dX and g2 = dx/dY. s_k = -N_k / N_z with N = g1 x g2: ds_k = q_k . dN = dg1 . (g2 x q_k)
        + dg2 . (q_k x g1), q_k = -(e_k + s_k e_z) / N_z."""
        g1, g2 = self._tangents(c, ids)
        N = geometry.cross(g1, g2)
        q = np.zeros((len(ids), 2, 3))
        q[:, (0, 1), (0, 1)] = 1.0
        q[..., 2] = geometry.slope_from_normal(N)
        q /= -N[:, None, 2:]
        by_tangents = np.stack([geometry.cross(g2[:, None], q), geometry.cross(q, g1[:, None])])
        if self._turns is None:
            return by_tangents
        return np.einsum("mka,amst->kmst", self._turns[ids], by_tangents)

    def _tangents(self, c: Array, ids: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return dx/dX and dx/dY (m, 3) at the markers."""
        return (
            self._along_x[ids] @ c.T + [1.0, 0.0, 0.0],
            self._along_y[ids] @ c.T + [0.0, 1.0, 0.0],
        )


_ASPECT_PER_DEPTH = np.sqrt(8 / 3)
"""Ratio of the axis ratio's standard deviation to the relative one of the depth. The outline is
assumed to have independent radial errors. The axis ratio is 1 - 2 c / r with c the second harmonic.
Its standard deviation is sqrt(8) times the relative one of the mean radius. For the depth, whose
tilt is fitted too, the factor is sqrt(3). Normals measured on rendered images have 0.8 to 0.9 of
the resulting standard deviation."""


def slope_sd(n: Array, p_CM: Array, variance: Array) -> Array:
    """Return the standard deviation (N,) of slopes measured at markers; see `slope_sd_of`. The
    markers have unit normals `n` and positions `p_CM` (N, 3), m, from the camera. `variance` (N,),
    m^2, is that of their depths."""
    far = np.sqrt(np.einsum("ni,ni->n", p_CM, p_CM))
    return slope_sd_of(n, p_CM / far[:, None], _ASPECT_PER_DEPTH * np.sqrt(variance) / far)


def slope_sd_of(n: ArrayLike, view: ArrayLike, aspect_sd: ArrayLike) -> Array:
    """Return the standard deviation (N,) of the slopes of markers with unit normals `n`.

    The markers are observed along unit rays `view` (N, 3). The tilt t against the line of sight
    comes from the ellipse's axis ratio cos(t). The standard deviation of this ratio is `aspect_sd`
    (N,). So d t = aspect_sd / sin(t), and for a face-on marker at most sqrt(aspect_sd). The tilt
    direction comes from the ellipse's axes, with the noise of the same second harmonic. So sin(t)
    d(angle) = aspect_sd sin(t) / (2 (1 - cos(t))), equal within 5 % up to 35 degrees. A slope is
    tan of an angle to the axis: d tan = d t / n_z^2.
    """
    n = np.asarray(n, dtype=float)
    aspect_sd = np.asarray(aspect_sd, dtype=float)
    sine2 = 1 - np.einsum("ni,ni->n", n, np.asarray(view, dtype=float)) ** 2
    return (
        aspect_sd
        / np.sqrt(np.maximum(sine2, np.maximum(aspect_sd, 1e-12)))
        / np.maximum(n[:, 2] ** 2, 1e-6)
    )
