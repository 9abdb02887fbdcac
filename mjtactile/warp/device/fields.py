"""Values that the kernels of membranes share: iteration, state and workspace."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Scheme:
    """Iteration: numbers of outer steps and sweeps, relaxation factors, tolerance, m."""

    outer: int
    batches: int
    sweeps_z: int
    sweeps_xy: int
    relaxation_z: float
    relaxation_xy: float
    tolerance: float
    bulge: float  # dV/dp of the free bulge, m^3/Pa


@wp.struct
class Fields:
    """State and workspace of all membranes: (F, 2, 3 or 4, N) and (F, N) for N nodes."""

    u: wp.array3d(dtype=float)
    kept: wp.array3d(dtype=float)
    force: wp.array2d(dtype=float)
    kept_force: wp.array2d(dtype=float)
    height: wp.array2d(dtype=float)
    slope_x: wp.array2d(dtype=float)
    slope_y: wp.array2d(dtype=float)
    owner: wp.array2d(dtype=int)
    next_slot: wp.array2d(dtype=int)
    next_fraction: wp.array2d(dtype=float)
    gap: wp.array2d(dtype=float)
    change: wp.array2d(dtype=float)
    step_before: wp.array2d(dtype=float)
    link_x: wp.array2d(dtype=float)
    link_y: wp.array2d(dtype=float)
    rx: wp.array2d(dtype=float)
    ry: wp.array2d(dtype=float)
    rz: wp.array2d(dtype=float)
    swell: wp.array2d(dtype=float)
    extra: wp.array2d(dtype=float)
    spring: wp.array3d(dtype=float)
    away: wp.array3d(dtype=float)
    pressure: wp.array(dtype=float)
    volume: wp.array(dtype=float)
    status: wp.array(dtype=int)
    iterations: wp.array(dtype=int)
    lost: wp.array(dtype=int)
    gain: wp.array(dtype=float)
