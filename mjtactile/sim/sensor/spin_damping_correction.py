"""Compensation of the braking torque of the implicit step on a rotating sensor.

MuJoCo's `discrete` integrator evaluates the membrane's forces at the end of the step. It does so to
first order: -h K v. In a rigid rotation the membrane's tension rotates too. Then K v is not zero
although the membrane does not deform. The lever arms are those at the start of the step. A torque
-h Q w remains. It stops a sensor spinning in vacuum within 0.4 s at a step of 4 ms.

Q is the sum over the edges d of all triangles of c (|d|^2 I - d d^T). Here c is the edge's force
over its length, N/m. MuJoCo's stiffness keeps the positive part of c
(docs/theory/simulation_contact.md, C4).
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.sim.sensor.mesh import MembraneMesh
from mjtactile.sim.sensor.rubber_flex import EdgeMatrices, stiffness_rows

_SLOW = 1e-4  # angular velocity, rad/s, below which no compensation is applied


class SpinCorrection:
    """Compensation of the braking torque on one sensor, by `xfrc_applied` of its MuJoCo body."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        body_id: int,
        flex_id: int,
        mesh: MembraneMesh,
    ):
        self._model = model
        self._data = data
        self._body = body_id
        self._step = float(model.opt.timestep)
        self._jacobian = np.zeros((3, model.nv))
        self._elements = EdgeMatrices(model, flex_id, mesh)
        free = model.flexedge_length0[model.flex_edgeadr[flex_id] :][self._elements.edges]
        self._free = free**2
        self._rows = stiffness_rows(model, flex_id)
        self._given = np.zeros(3)
        self._velocity = np.zeros(3)
        self._gives = False

    def update(self, p_SV: Array) -> None:
        """Apply the torque for the next step with vertices at `p_SV` (n, 3) m, after the
        stiffness."""
        data = self._data
        turning = data.cvel[self._body, :3]  # at the last step's beginning
        if turning.dot(turning) < _SLOW**2 and not self._gives:
            return
        mujoco.mj_jacBody(self._model, data, None, self._jacobian, self._body)
        velocity = self._jacobian @ data.qvel
        # The velocity at the end of the step is relevant. Without a previous compensation the
        # velocity may have been set externally.
        expected = 2 * velocity - self._velocity if self._gives else velocity
        self._velocity = velocity
        R_WS = data.xmat[self._body].reshape(3, 3)
        self._give(self._step * R_WS @ self.resistance(p_SV) @ R_WS.T @ expected)

    def stop(self) -> None:
        """Set the compensation to zero, because the membrane is not in the solve."""
        if self._gives:
            self._give(np.zeros(3))

    def resistance(self, p_SV: Array) -> Array:
        """Return Q (3, 3), N m, in S."""
        ends = self._elements.ends[self._elements.edges]
        xx, xy, xz, yy, yz, zz = self._rows.T
        edges = p_SV[ends[..., 1]] - p_SV[ends[..., 0]]  # shape (m, 3, 3)
        lengths2 = (edges * edges).sum(axis=2)
        a, b, c = (lengths2 - self._free).T
        force = np.maximum(
            np.stack(
                [xx * a + xy * b + xz * c, xy * a + yy * b + yz * c, xz * a + yz * b + zz * c],
                axis=1,
            ),
            0.0,
        )
        flat = edges.reshape(-1, 3)
        return np.vdot(force, lengths2) * np.eye(3) - (flat * force.reshape(-1, 1)).T @ flat

    def _give(self, torque: Array) -> None:
        """Apply the change of the torque, so that torques of other sources remain."""
        self._data.xfrc_applied[self._body, 3:] += torque - self._given
        self._given = torque
        self._gives = bool(torque.any())
