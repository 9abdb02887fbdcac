"""Marker positions of membranes: spline through the nodes, with the shear of sticking patches (X7).

The rules of `QuasistaticSensor.p_SV`: nodes in contact move with their body by its strain, all
other nodes go to equilibrium. SI units, frame S.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.contact import Patch
from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid, node_at
from mjtactile.warp.device.relaxation import synchronize
from mjtactile.warp.device.sticking import (
    Sticking,
    find_loads,
    list_held,
    moved_by,
    node_of,
    patch_of,
    start_from,
)

wp.set_module_options({"enable_backward": False})

_CLOSE = wp.constant(1.0e-8)  # squared residual of the displacements, over that of the start


@wp.kernel
def find_markers(
    membrane: MembraneGrid,
    fields: Fields,
    patches: wp.array2d(dtype=Patch),
    slot_of: wp.array2d(dtype=int),
    sticking: Sticking,
    rest: wp.array(dtype=wp.vec3),
    weights: wp.array2d(dtype=float),
    to: wp.array2d(dtype=wp.vec3),
):
    # `rest` (M,) on the flat membrane; `weights` (M, N), displacements per node
    f, lane = wp.tid()
    threads = wp.block_dim()
    finger = f % slot_of.shape[0]
    inner = (membrane.nx - 2) * (membrane.ny - 2)
    list_held(membrane, fields, sticking, slot_of, f, finger, lane)
    for a in range(lane, 2 * sticking.count[f], threads):
        n = sticking.held[f, a // 2]
        k = node_of(membrane, n)
        patch = patches[f, patch_of(fields, slot_of, f, finger, k) - 1]
        moved = float(0.0)
        if patch.touches != 0:
            x = node_at(membrane, fields.u, f, k // membrane.ny, k % membrane.ny) - patch.middle
            moved = patch.strain[0] - patch.strain[2] * x[1]
            if a % 2 == 1:
                moved = patch.strain[1] + patch.strain[2] * x[0]
        start_from(sticking, f, 2 * n + a % 2, moved)
    find_loads(sticking, f, lane, threads, _CLOSE)
    for row in range(lane, 2 * inner, threads):
        sticking.moved[f, row] = moved_by(sticking, sticking.loads, f, row)
    synchronize()
    for m in range(lane, rest.shape[0], threads):
        at = rest[m]
        for n in range(inner):
            k = node_of(membrane, n)
            shear = wp.vec3(sticking.moved[f, 2 * n], sticking.moved[f, 2 * n + 1], 0.0)
            u = wp.vec3(fields.u[f, 0, k], fields.u[f, 1, k], fields.u[f, 2, k])
            at += weights[m, k] * (u + shear)
        to[f, m] = at
