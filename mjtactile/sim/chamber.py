"""The chamber behind the membrane: its volume, and the tendon through which MuJoCo integrates its gas implicitly.

A trapped gas is far stiffer than the membrane's mass allows any explicit pressure to be. The chamber is therefore a
fixed tendon whose coefficients are dV/dq: moving it by one unit changes the volume by one cubic metre, its force is a
pressure, and its stiffness -dp/dV joins the integrator's implicit system. Each step re-linearises it at the current
state, in the sensor's own frame.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.sim.mesh import MembraneMesh, spline_rows
from mjtactile.types import Array


class ChamberGeometry:
    """Volume between the membrane and the glass, and its derivative by the vertex positions.

    The membrane is the smooth surface that carries the markers (the tensor spline of mesh.py), not its facets: they cut
    the corners of bulge and dent by about 3 % of the bulge, which by the gas's stiffness would be 10 % of a force.
    """

    def __init__(self, mesh: MembraneMesh, volume_flat: float):
        self._shape, self._volume_flat = (mesh.nx, mesh.ny), volume_flat
        (u, wu), (v, wv) = (_gauss_points(knots) for knots in mesh.knots)
        self._x, self._x_u = spline_rows(mesh.knots[0], u)
        self._y, self._y_v = (rows.T.copy() for rows in spline_rows(mesh.knots[1], v))
        self._weights = np.outer(wu, wv)
        self._inside = (slice(None), slice(1, -1), slice(1, -1))

    def volume_and_gradient(self, p_SV: Array) -> tuple[float, Array]:
        """Return V (m^3) and dV/dp (k, 3) m^2 at the interior vertices.

        Divergence theorem: V = V_flat + integral of z N_z, N = x_u cross x_v, since the rim lies in z = 0; the gradient is
        that of the quadrature itself, so that the gas can do no net work around a loop.
        """
        p = p_SV.T.reshape(3, *self._shape)
        across = self._x @ p  # (3, u, ny)
        x_u, x_v = self._x_u @ p[:2] @ self._y, across[:2] @ self._y_v
        z = across[2] @ self._y
        N_z = x_u[0] * x_v[1] - x_u[1] * x_v[0]
        wz = self._weights * z
        gradient = np.empty_like(p)
        gradient[2] = self._x.T @ (self._weights * N_z) @ self._y.T
        gradient[0] = self._x_u.T @ (wz * x_v[1]) @ self._y.T - self._x.T @ (wz * x_u[1]) @ self._y_v.T
        gradient[1] = self._x.T @ (wz * x_u[0]) @ self._y_v.T - self._x_u.T @ (wz * x_v[0]) @ self._y.T
        return self._volume_flat + float(np.vdot(wz, N_z)), gradient[self._inside].reshape(3, -1).T


def _gauss_points(knots: Array) -> tuple[Array, Array]:
    """Two Gauss points in every cell of a grid line, and their weights: the error falls with the fourth power of the cell."""
    left, width = knots[:-1], np.diff(knots)
    offset = np.array([-1.0, 1.0]) / np.sqrt(12.0)
    return (left + width / 2)[:, None].repeat(2, 1).ravel() + (width[:, None] * offset).ravel(), np.repeat(width / 2, 2)


class GasTendon:
    """Writes pressure and gas stiffness of one chamber into a compiled model, once before every step."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, tendon_id: int):
        self._model, self._data, self._tendon = model, data, tendon_id
        start, count = int(model.tendon_adr[tendon_id]), int(model.tendon_num[tendon_id])
        self._wraps = slice(start, start + count)
        first = int(model.wrap_objid[start])  # the vertex joints are one block, in the tendon's order
        qpos, dof = int(model.jnt_qposadr[first]), int(model.jnt_dofadr[first])
        self.dofs = slice(dof, dof + count)
        self.displacements: Array = np.asarray(data.qpos)[qpos:qpos + count]
        """Live view of the interior vertices' displacements in S, (3 k,) m."""

    def apply(self, pressure_gauge: float, stiffness: float, gradient: Array) -> None:
        """Push with the pressure, `gradient` (k, 3) = dV/dq, and let the tendon's spring carry its change in the step.

        The spring is relaxed at the current state, so that it holds the *implicit* part only: f = p - k (V' - V).
        """
        coefficients = gradient.ravel()
        self._model.wrap_prm[self._wraps] = coefficients
        self._model.tendon_stiffness[self._tendon] = stiffness
        self._model.tendon_lengthspring[self._tendon] = coefficients @ self.displacements
        self._data.qfrc_applied[self.dofs] = pressure_gauge * coefficients
