"""Elastic forces, gas forces and link stiffness of a membrane's nodes, as Warp functions.

Equations X1 to X3 of docs/theory/quasistatic_membrane.md, at the four corners of each cell. Single
precision, SI units, frame S.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.cut_cells import NodeLoad, add_triangles, triangle_at
from mjtactile.warp.device.grid import MIN_DET, MIN_TENSION, MembraneGrid, node_at, stress

wp.set_module_options({"enable_backward": False})


@wp.func
def node_load(
    membrane: MembraneGrid, u: wp.array3d(dtype=float), f: int, i: int, j: int, scale: float
) -> NodeLoad:
    """Return the load of node (i, j), summed over the corners of its cells.

    A node's force depends on three corners of each cell: its own, and the two at the ends of its
    edges.
    """
    load = NodeLoad()
    cell = 0.25 * membrane.dx * membrane.dy
    force = wp.vec3(0.0, 0.0, 0.0)
    swell = wp.vec3(0.0, 0.0, 0.0)
    link_x = float(0.0)
    link_y = float(0.0)
    volume = float(0.0)
    min_area_ratio = float(1.0e3)
    a = node_at(membrane, u, f, i, j)
    for e in range(4):
        si = 1 - 2 * (e // 2)
        sj = 1 - 2 * (e % 2)
        ii = i + si
        jj = j + sj
        w = float(0.0)
        if ii >= 0 and ii < membrane.nx and jj >= 0 and jj < membrane.ny:
            w = cell * membrane.cut.whole[wp.min(i, ii) * membrane.ny + wp.min(j, jj)]
        if w > 0.0:
            b = node_at(membrane, u, f, ii, j)
            d = node_at(membrane, u, f, i, jj)
            c = node_at(membrane, u, f, ii, jj)
            sx = float(si) / membrane.dx
            sy = float(sj) / membrane.dy
            g1 = (b - a) * sx
            g2 = (d - a) * sy
            s = w * stress(membrane, scale, g1, g2)
            force += (g1 * s[0] + g2 * s[2]) * sx + (g2 * s[1] + g1 * s[2]) * sy
            h2 = (c - b) * sy  # at b, g1 and h2 meet
            sb = w * stress(membrane, scale, g1, h2)
            force += (g1 * sb[0] + h2 * sb[2]) * sx
            h1 = (c - d) * sx  # at d, h1 and g2 meet
            sd = w * stress(membrane, scale, h1, g2)
            force += (g2 * sd[1] + h1 * sd[2]) * sy
            t_a = g1[0] * g2[1] - g1[1] * g2[0]
            volume += w * a[2] * t_a
            min_area_ratio = wp.min(min_area_ratio, t_a)
            swell += w * wp.vec3(
                a[2] * (g1[1] * sy - g2[1] * sx) - b[2] * h2[1] * sx + d[2] * h1[1] * sy,
                a[2] * (g2[0] * sx - g1[0] * sy) + b[2] * h2[0] * sx - d[2] * h1[0] * sy,
                t_a,
            )
            fair = MIN_TENSION * 0.5 * wp.max(s[0] + s[1], 0.0)
            flat = 1.0 / (1.0 + g1[2] * g1[2] + g2[2] * g2[2])
            if si > 0:
                flat_b = 1.0 / (1.0 + g1[2] * g1[2] + h2[2] * h2[2])
                link_x += (wp.max(s[0], fair) * flat + wp.max(sb[0], fair) * flat_b) * sx * sx
            if sj > 0:
                flat_d = 1.0 / (1.0 + h1[2] * h1[2] + g2[2] * g2[2])
                link_y += (wp.max(s[1], fair) * flat + wp.max(sd[1], fair) * flat_d) * sy * sy
    load.elastic = force
    load.swell = swell
    load.link_x = link_x
    load.link_y = link_y
    load.volume = volume
    load.min_area_ratio = min_area_ratio
    if membrane.cut.count > 0:
        load = add_triangles(membrane, u, f, i * membrane.ny + j, scale, load)
    return load


@wp.func
def _tension(membrane: MembraneGrid, s: wp.vec3, g1: wp.vec3, g2: wp.vec3) -> float:
    """Return the tension times area, N m, of a part; `s`: stress times thickness and area."""
    c11 = membrane.lambda2 * wp.dot(g1, g1)
    c22 = membrane.lambda2 * wp.dot(g2, g2)
    c12 = membrane.lambda2 * wp.dot(g1, g2)
    root = 1.0 / wp.sqrt(wp.max(c11 * c22 - c12 * c12, MIN_DET))
    return 0.5 * root * (s[0] * c11 + s[1] * c22 + 2.0 * s[2] * c12)


@wp.func
def mean_tension(
    membrane: MembraneGrid,
    u: wp.array3d(dtype=float),
    f: int,
    lane: int,
    threads: int,
    scale: float,
) -> float:
    """Return the mean tension of membrane `f`, N/m."""
    total = float(0.0)
    w = 0.25 * membrane.dx * membrane.dy
    for k in range(lane, membrane.nx * membrane.ny, threads):
        i = k // membrane.ny
        j = k - i * membrane.ny
        a = node_at(membrane, u, f, i, j)
        for e in range(4):
            si = 1 - 2 * (e // 2)
            sj = 1 - 2 * (e % 2)
            ii = i + si
            jj = j + sj
            if ii >= 0 and ii < membrane.nx and jj >= 0 and jj < membrane.ny:
                whole = membrane.cut.whole[wp.min(i, ii) * membrane.ny + wp.min(j, jj)]
                if whole > 0.0:
                    g1 = (node_at(membrane, u, f, ii, j) - a) * (float(si) / membrane.dx)
                    g2 = (node_at(membrane, u, f, i, jj) - a) * (float(sj) / membrane.dy)
                    total += _tension(membrane, w * stress(membrane, scale, g1, g2), g1, g2)
    for t in range(lane, membrane.cut.count, threads):
        part = triangle_at(membrane, u, f, t, scale)
        total += _tension(membrane, part.stress, part.g1, part.g2)
    return wp.tile_extract(wp.tile_sum(wp.tile(total)), 0) / membrane.opening
