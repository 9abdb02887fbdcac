"""In-plane compliance of a membrane and workspace of sticking patches, for the device (X7)."""

from __future__ import annotations

from typing import Any

import warp as wp

from mjtactile.sim.sensor.quasistatic_geoms import sticking_of
from mjtactile.warp.arrays import floats
from mjtactile.warp.device.sticking import Sticking
from mjtactile.warp.membranes import Membranes


def new_sticking(membranes: Membranes) -> Any:
    """Return the compliance, and workspace of all membranes."""
    count = membranes.count
    compliance = sticking_of(membranes.membrane).compliance
    sticking = Sticking()
    sticking.compliance = floats(compliance)
    for name in ("loads", "residual", "direction", "moved"):
        setattr(sticking, name, wp.zeros((count, len(compliance)), dtype=float))
    for name in ("held", "known"):
        setattr(sticking, name, wp.zeros((count, len(compliance) // 2), dtype=int))
    for name in ("count", "stale"):
        setattr(sticking, name, wp.zeros(count, dtype=int))
    return sticking
