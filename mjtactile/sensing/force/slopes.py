"""Slopes of the membrane at its markers, as data for the inverse (docs/theory/membrane_inverse.md,
Eq. F11).

A marker is a circle in the membrane surface, so its ellipse gives the slopes there. Markers far
apart see a flat face only from its rim. Their slopes distinguish it from a ball that indents
deeper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjtactile.core import geometry
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.spline_fem import Sheet
from mjtactile.sensing.settings import InverseSettings
from mjtactile.sensing.surface.slope_noise import slope_sd


class MarkerSlopes:
    """Slopes (dz/dx, dz/dy) of one membrane at its markers. The marker positions (N, 3), m, are
    those of the mounted flat membrane. `distance`, m, is that of the camera."""

    def __init__(self, sheet: Sheet, p_SM: Array, distance: float, settings: InverseSettings):
        self._settings = settings
        own = sheet.own(p_SM[:, :2])
        self._along_x, self._along_y = sheet.slopes(own)
        self._turns = None if sheet.design.frame.outline is None else sheet.turns(own)
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
        off = np.abs(self.off(markers, c)).max(axis=1)
        is_used = (sd < s.slope_sd_max) & (off < s.slope_off_max)  # False for NaN
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
        """dx/dX and dx/dY (m, 3) at the markers."""
        return (
            self._along_x[ids] @ c.T + [1.0, 0.0, 0.0],
            self._along_y[ids] @ c.T + [0.0, 1.0, 0.0],
        )
