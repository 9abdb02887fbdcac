"""Chamber behind the membrane: its volume, and the tendon of its implicit gas.

A trapped gas is far too stiff for an explicit pressure on a membrane of this mass. The chamber is
therefore a fixed tendon whose coefficients are dV/dq. Moving it by one unit changes the volume by
one cubic meter, and its force is a pressure. Its stiffness -dp/dV joins the integrator's implicit
system. Each step re-linearizes it at the current state, in the sensor's own frame. The pressure
acts along all axes. The stiffness needs only dV/dz, because the membrane is far stiffer in its
plane.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.kernels import bound
from mjtactile.sim.sensor.mesh import MembraneMesh

# offset of the tendon length, as a fraction of the sum of its contributions, m^3
_OFFSET = 1e-10
_MIN_LENGTH = 1e-12


class ChamberGeometry:
    """Volume between the membrane and the glass, and its derivative by the vertex positions."""

    def __init__(self, mesh: MembraneMesh, volume_flat: float):
        self._interior = mesh.interior
        self._volume_flat = volume_flat
        self._p_SV = np.empty_like(mesh.p_SV)
        self._gradient = np.empty_like(mesh.p_SV)
        self._above_frame = np.empty(1)  # volume above the frame, m^3
        vertices = (len(mesh.p_SV), self._p_SV)
        triangles = (len(mesh.triangles), np.ascontiguousarray(mesh.triangles))
        results = (self._gradient, self._above_frame)
        self._measure = bound("chamber_volume", *vertices, *triangles, *results)

    def volume_and_gradient(self, p_SV: Array) -> tuple[float, Array]:
        """Return V (m^3) and dV/dp (k, 3) m^2 at the interior vertices of the triangulated surface.

        Divergence theorem: V = V_flat + 1/3 sum of centroid . area vector, because the flat edge
        lies in z = 0. Each vertex gets a third of the area vector of each of its triangles.
        """
        self._p_SV[:] = p_SV
        self._measure()
        volume = self._volume_flat + float(self._above_frame[0])
        return volume, np.take(self._gradient, self._interior, axis=0)


class GasTendon:
    """Pressure and gas stiffness of one chamber in a compiled model, written before every step."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, tendon_id: int, count: int):
        """Connect to the tendon of `count` vertices. The model states 0 while a sensor sleeps."""
        self._model = model
        self._tendon = tendon_id
        start = int(model.tendon_adr[tendon_id])
        # live views
        coefficients = model.wrap_prm[start : start + count]
        self._count = count
        self._spring = model.tendon_stiffness[tendon_id : tendon_id + 1]
        rest = model.tendon_lengthspring[tendon_id]
        # the vertex joints are one block, x, y, z of each vertex
        first = int(model.wrap_objid[start]) - 2
        count = 3 * count
        qpos = int(model.jnt_qposadr[first])
        dof = int(model.jnt_dofadr[first])
        self.dofs = slice(dof, dof + count)
        self.displacements: Array = np.asarray(data.qpos)[qpos : qpos + count]
        """Live view of the interior vertices' displacements in S, (3 k,) m."""
        self.forces: Array = np.asarray(data.qfrc_applied)[self.dofs]
        """Live view of the forces applied to them, (3 k,) N."""
        vertices = (self._count, ..., self.displacements, _OFFSET, _MIN_LENGTH)
        results = (coefficients, self._spring, rest, self.forces)
        self._apply = bound("apply_gas_load", *vertices, ..., ..., *results)

    def apply(self, gauge_pressure: float, stiffness: float, gradient: Array) -> None:
        """Apply the pressure and its change in the step. `gradient` (k, 3) is dV/dq.

        The tendon's spring supplies the change. It is relaxed at the current state and holds the
        *implicit* part only: f = p - k (V' - V). MuJoCo leaves out the stiffness of a spring at
        exactly its rest length, which rounding sometimes produces. Therefore the length is offset,
        and the resulting force is compensated.
        """
        self._apply(gradient, gauge_pressure, stiffness)

    def suspend(self) -> None:
        """Remove the tendon's joints and the pressure from the model."""
        self._model.tendon_num[self._tendon] = 0
        self._spring[0] = 0.0
        self.forces[:] = 0.0

    def resume(self) -> None:
        """Restore the tendon's joints. `apply` restores the pressure."""
        self._model.tendon_num[self._tendon] = self._count
