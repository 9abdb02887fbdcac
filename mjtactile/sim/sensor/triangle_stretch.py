"""Principal stretches of a membrane, triangle by triangle."""

from __future__ import annotations

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sim.sensor.mesh import MembraneMesh


def stretches_of(design: SensorDesign, mesh: MembraneMesh, p_SV: Array) -> tuple[Array, Array]:
    """Return principal stretches (m, 2), relative to the free membrane, and areas (m,) m^2."""
    now = p_SV[mesh.triangles]
    moved = now[:, 1:] - now[:, :1]
    F = mesh.inverse_edges @ moved  # rows: dx/dX and dx/dY, (m, 2, 3)
    xx, yy, xy = (np.einsum("ki,ki->k", F[:, i], F[:, j]) for i, j in ((0, 0), (1, 1), (0, 1)))
    mean = (xx + yy) / 2
    spread = np.hypot((xx - yy) / 2, xy)
    squares = np.maximum(np.stack([mean - spread, mean + spread], axis=1), 0.0)
    area = np.sqrt(np.maximum(xx * yy - xy * xy, 0.0)) * mesh.triangle_areas
    return design.membrane.pre_stretch * np.sqrt(squares), area
