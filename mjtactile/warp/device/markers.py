"""Marker positions of membranes: spline through the nodes, with the shear of sticking patches (X7).

The rules of `QuasistaticSensor.p_SV`: loads of the nodes in contact displace all nodes.
SI units, frame S.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid
from mjtactile.warp.device.relaxation import synchronize
from mjtactile.warp.device.sticking import NodeLoads, Sticking, moved_by, node_of

wp.set_module_options({"enable_backward": False})


@wp.kernel
def find_markers(
    membrane: MembraneGrid,
    fields: Fields,
    nodes: NodeLoads,
    sticking: Sticking,
    rest: wp.array(dtype=wp.vec3),
    weights: wp.array2d(dtype=float),
    to: wp.array2d(dtype=wp.vec3),
):
    # `rest` (M,) on the flat membrane; `weights` (M, N), displacements per node
    f, lane = wp.tid()
    threads = wp.block_dim()
    inner = (membrane.nx - 2) * (membrane.ny - 2)
    for n in range(lane, inner, threads):
        k = node_of(membrane, n)
        for axis in range(2):
            sticking.loads[f, 2 * n + axis] = nodes.load[f, axis, k]
    synchronize()
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
