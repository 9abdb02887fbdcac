"""How steep the sheet will be beside an object: what decides whether it can stand in its own light
(effects.py)."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign


def deepest(design: SensorDesign, half_extents: tuple[float, float], force: float) -> float:
    """Angle t, rad, at which the sheet leaves an ellipsoid of half extents a, b m across, pressed
    with `force` F, N:

        F = pi [(a + b) T(t) + a b p] sin(t)^2,
        T = T0 + E h / (1 - nu^2) (1 / cos(t) - 1) / 2                  (Eq. L5)

    It touches as far as the object is no steeper; a flank's stretch spreads over twice its length.
    Spheres of 4-16 mm up to 1.8 N, 21 to 47 degrees steep in simulation: -4 to +4 degrees. Beside
    the frame's wall more is steeper still.
    """
    sheet = design.membrane
    a, b = half_extents
    if not math.isfinite(a + b):
        return 0.0
    stiffness = sheet.young * sheet.thickness / (1 - sheet.poisson**2) / 2
    pressure = max(design.chamber.supply_gauge, 0.0)

    def unbalanced(t: float) -> float:
        tension = sheet.pretension + stiffness * (1 / math.cos(t) - 1)
        return math.pi * ((a + b) * tension + a * b * pressure) * math.sin(t) ** 2 - force

    # halved until nothing is left of it; it grows with the angle
    low = 0.0
    high = 1.5707
    for _ in range(52):
        middle = (low + high) / 2
        low, high = (low, middle) if unbalanced(middle) > 0 else (middle, high)
    return high


def half_extents(model: mujoco.MjModel, geoms: NDArray[np.int64]) -> tuple[float, float]:
    """Half the size of `geoms` along y and z, m, as the model is compiled: fingers close along x.
    Infinite without any."""
    if not len(geoms):
        return math.inf, math.inf
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
    box = model.geom_aabb[geoms]
    middle = data.geom_xpos[geoms] + np.einsum("nij,nj->ni", turn, box[:, :3])
    reach = np.einsum("nij,nj->ni", np.abs(turn), box[:, 3:])
    half = ((middle + reach).max(axis=0) - (middle - reach).min(axis=0)) / 2
    return float(half[1]), float(half[2])
