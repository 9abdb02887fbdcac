"""A sensor that turns keeps turning: the torque with which the implicit step resists is given back.

MuJoCo's `discrete` integrator takes the sheet's forces from where the step will end, to first order: -h K v. Turning as a
whole, the sheet's tension turns along, so that K v is not zero although nothing deforms; and since the lever arms are those
of the step's beginning, a torque -h Q w is left, which brakes a sensor spinning in vacuum within 0.4 s at a step of 4 ms. Q
is the sum over the edges d of all triangles of c (|d|^2 I - d d^T), where c is the edge's force over its length, N/m, of
which MuJoCo's stiffness keeps what is positive (docs/equations.md, C4).
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.design import Membrane
from mjtactile.core.types import Array
from mjtactile.sim.sensor.mesh import MembraneMesh

_SLOW = 1e-4  # rad/s; below, nothing is given back


class Turning:
    """Gives back the braking torque of one sensor, as an external torque on its body (`xfrc_applied`)."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, body_id: int, mesh: MembraneMesh, sheet: Membrane):
        self._model, self._data, self._body, self._step = model, data, body_id, float(model.opt.timestep)
        self._jacobian = np.zeros((3, model.nv))
        self._ends = mesh.triangles, np.roll(mesh.triangles, -1, axis=1)  # (m, 3) each: edge k from corner k to the next
        mounted = (mesh.p_SV[self._ends[1]] - mesh.p_SV[self._ends[0]])[:, :, :2]  # (m, 3, 2)
        self._free = (mounted**2).sum(axis=2) / sheet.pre_stretch**2
        # Every symmetric matrix is sum c_k d_k d_k^T of a triangle's edges d_k: so are strain and stress.
        x, y = mounted[..., 0], mounted[..., 1]
        by_edges = np.linalg.inv(np.stack([x * x, y * y, x * y], axis=1))  # (m, 3, 3): xx, yy, xy to c
        nu = sheet.poisson
        law = sheet.young * sheet.thickness / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])
        area = mesh.triangle_areas[:, None, None]
        # A squared length is (x^2, y^2, 2 x y) . (C_xx, C_yy, C_xy); Green's strain is half the change of C, xy twice.
        self._stiffness = area * by_edges @ law @ by_edges.transpose(0, 2, 1) * sheet.pre_stretch**2 / 2
        self._given, self._velocity, self._gives = np.zeros(3), np.zeros(3), False

    def update(self, p_SV: Array) -> None:
        """Give back what the next step will take, with the vertices at `p_SV` (n, 3) m; call before every step."""
        data = self._data
        turning = data.cvel[self._body, :3]  # at the last step's beginning
        if turning.dot(turning) < _SLOW**2 and not self._gives:
            return
        mujoco.mj_jacBody(self._model, data, None, self._jacobian, self._body)
        velocity = self._jacobian @ data.qvel
        # What counts is the velocity at the step's end. Where nothing was given back yet, somebody may have set the velocity.
        expected = 2 * velocity - self._velocity if self._gives else velocity
        self._velocity = velocity
        R_WS = data.xmat[self._body].reshape(3, 3)
        self._give(self._step * R_WS @ self.resistance(p_SV) @ R_WS.T @ expected)

    def stop(self) -> None:
        """Give nothing back: the sheet is not in the solve."""
        if self._gives:
            self._give(np.zeros(3))

    def resistance(self, p_SV: Array) -> Array:
        """Q (3, 3) N m in S."""
        edges = p_SV[self._ends[1]] - p_SV[self._ends[0]]  # (m, 3, 3)
        lengths2 = (edges * edges).sum(axis=2)
        force = np.maximum((self._stiffness @ (lengths2 - self._free)[..., None])[..., 0], 0.0)  # N/m
        flat = edges.reshape(-1, 3)
        return np.vdot(force, lengths2) * np.eye(3) - (flat * force.reshape(-1, 1)).T @ flat

    def _give(self, torque: Array) -> None:
        """Others may have written torques of their own: change by the difference."""
        self._data.xfrc_applied[self._body, 3:] += torque - self._given
        self._given, self._gives = torque, bool(torque.any())
