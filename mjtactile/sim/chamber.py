"""The gas behind the membrane: volume, pressure, valve, and the tendon through which MuJoCo integrates it implicitly.

A trapped gas is far stiffer than the membrane's mass allows any explicit pressure to be. The chamber is therefore a
fixed tendon whose coefficients are dV/dq: moving it by one unit changes the volume by one cubic metre, its force is a
pressure, and its stiffness -dp/dV joins the integrator's implicit system. Each step re-linearises it at the current
state, in the sensor's own frame.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from scipy.sparse import csr_matrix

from mjtactile.errors import InputError
from mjtactile.sim.membrane import MembraneMesh
from mjtactile.types import Array


class ChamberGeometry:
    """Volume between the membrane and the glass, and its derivative by the vertex positions."""

    def __init__(self, mesh: MembraneMesh, volume_flat: float):
        self._corners, self._volume_flat = mesh.triangles.T.ravel(), volume_flat
        count = len(mesh.triangles)
        # Each interior vertex takes a third of the area vector of each triangle that it belongs to.
        scatter = csr_matrix((np.full(3 * count, 1 / 3), (mesh.triangles.ravel(), np.repeat(np.arange(count), 3))),
                             shape=(len(mesh.p_SV), count))
        self._scatter = scatter[mesh.interior]

    def volume_and_gradient(self, p_SV: Array) -> tuple[float, Array]:
        """Return V (m^3) and dV/dp (k, 3) m^2 at the interior vertices, exact for the triangulated surface.

        Divergence theorem: V = V_flat + 1/3 sum of centroid . area vector, since the flat rim lies in z = 0.
        """
        a, b, c = p_SV.T[:, self._corners].reshape(3, 3, -1).swapaxes(0, 1)  # each (3, m): rows x, y, z
        u, w = b - a, c - a
        area = np.empty_like(u)  # area vectors; written out, since np.cross takes ten times as long
        area[0] = u[1] * w[2] - u[2] * w[1]
        area[1] = u[2] * w[0] - u[0] * w[2]
        area[2] = u[0] * w[1] - u[1] * w[0]
        area *= 0.5
        volume = self._volume_flat + float(np.vdot(a + b + c, area)) / 9
        return volume, self._scatter @ area.T


class Gas:
    """Gas in the chamber: at the supply's pressure while the valve is open, a kept amount (p V^gamma) when closed."""

    def __init__(self, ambient: float, heat_ratio: float):
        self.ambient, self.heat_ratio = ambient, heat_ratio
        self._supply_gauge, self._constant = 0.0, math.nan
        self._is_open = True

    @property
    def is_open(self) -> bool:
        return self._is_open

    @property
    def supply_gauge(self) -> float:
        """Pressure that the open valve connects to, Pa above ambient."""
        return self._supply_gauge

    def open(self, supply_gauge: float) -> None:
        """Connect the chamber to a supply. Raises InputError when the pressure is not a possible one."""
        if not math.isfinite(supply_gauge) or supply_gauge <= -self.ambient:
            raise InputError(f"{supply_gauge!r} Pa is not above vacuum (-{self.ambient:g} Pa)", source="valve",
                             field="supply_gauge")
        self._supply_gauge, self._is_open = float(supply_gauge), True

    def close(self, volume: float) -> None:
        """Trap the gas that is in `volume` m^3 now; does nothing when the valve is closed already."""
        if self._is_open:
            self._constant = (self._supply_gauge + self.ambient) * volume**self.heat_ratio
            self._is_open = False

    def pressure_and_stiffness(self, volume: float) -> tuple[float, float]:
        """Return gauge pressure (Pa) and -dp/dV (Pa/m^3): p V^gamma is constant, so -dp/dV = gamma p / V."""
        if self._is_open:
            return self._supply_gauge, 0.0
        absolute = self._constant / volume**self.heat_ratio
        return absolute - self.ambient, self.heat_ratio * absolute / volume


class GasTendon:
    """Writes pressure and gas stiffness of one chamber into a compiled model, once before every step."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, tendon_id: int):
        self._model, self._data, self._tendon = model, data, tendon_id
        start, count = int(model.tendon_adr[tendon_id]), int(model.tendon_num[tendon_id])
        self._wraps = slice(start, start + count)
        first = int(model.wrap_objid[start])  # the vertex joints are one block, in the tendon's order
        qpos, dof = int(model.jnt_qposadr[first]), int(model.jnt_dofadr[first])
        self._dofs = slice(dof, dof + count)
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
        self._data.qfrc_applied[self._dofs] = pressure_gauge * coefficients
