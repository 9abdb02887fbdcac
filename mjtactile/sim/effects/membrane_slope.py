"""Membrane slope next to an object, used to predict self-shadowing (effects.py)."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign


def deepest(design: SensorDesign, half_extents: tuple[float, float], force: float) -> float:
    """Return the membrane slope angle t, rad, at the contact edge of an ellipsoid.

    The ellipsoid has half extents a, b m across and is loaded with `force` F, N:

        F = pi [(a + b) T(t) + a b p] sin(t)^2,
        T = T0 + E h / (1 - nu^2) (1 / cos(t) - 1) / 2                  (Eq. L5)

    The contact extends to the point where the object has this slope. The stretch of the flank
    spreads over twice its length. The error is -4 to +4 degrees for spheres of 4-16 mm up to 1.8 N.
    Their slopes are 21 to 47 degrees in simulation. Next to the frame's wall the slope is
    larger.
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

    # bisection to machine precision; the force balance increases with the angle
    low = 0.0
    high = 1.5707
    for _ in range(52):
        middle = (low + high) / 2
        low, high = (low, middle) if unbalanced(middle) > 0 else (middle, high)
    return high


def half_extents(model: mujoco.MjModel, geoms: NDArray[np.int64]) -> tuple[float, float]:
    """Return half the size of `geoms` along y and z, m; infinite without any."""
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
