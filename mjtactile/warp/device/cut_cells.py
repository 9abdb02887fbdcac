"""Loads of a membrane in the triangles of cells that an outline cuts, as Warp functions (X8)."""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.grid import MIN_TENSION, MembraneGrid, stress

wp.set_module_options({"enable_backward": False})


@wp.struct
class NodeLoad:
    """Load of one node.

    `elastic` N. `swell` m^2, the derivative of the volume by its position. `link_x` and `link_y`
    N/m, stiffness towards +x and +y. `volume` m^3. `min_area_ratio`, minimum over the corners.
    """

    elastic: wp.vec3
    swell: wp.vec3
    link_x: float
    link_y: float
    volume: float
    min_area_ratio: float


@wp.struct
class Triangle:
    """Triangle of a cut cell: tangents, mean height, m, stress times thickness and area, N m."""

    g1: wp.vec3
    g2: wp.vec3
    mean: float
    stress: wp.vec3


@wp.func
def triangle_at(
    membrane: MembraneGrid, u: wp.array3d(dtype=float), f: int, t: int, scale: float
) -> Triangle:
    """Return a triangle of a cut cell; displacements vanish at its fixed corners."""
    found = Triangle()
    g1 = wp.vec3(1.0, 0.0, 0.0)
    g2 = wp.vec3(0.0, 1.0, 0.0)
    mean = float(0.0)
    for a in range(3):
        k = membrane.cut.nodes[3 * t + a]
        if k >= 0:
            by = membrane.cut.slopes[3 * t + a]
            moved = wp.vec3(u[f, 0, k], u[f, 1, k], u[f, 2, k])
            g1 += moved * by[0]
            g2 += moved * by[1]
            mean += moved[2] / 3.0
    found.g1 = g1
    found.g2 = g2
    found.mean = mean
    found.stress = membrane.cut.area[t] * stress(membrane, scale, g1, g2)
    return found


@wp.func
def add_triangles(
    membrane: MembraneGrid, u: wp.array3d(dtype=float), f: int, k: int, scale: float, to: NodeLoad
) -> NodeLoad:
    """Add the triangles at node `k` to its load."""
    cut = membrane.cut
    load = to
    for e in range(cut.first_corner[k], cut.first_corner[k + 1]):
        t = cut.corners[e] // 3
        by = cut.slopes[cut.corners[e]]
        part = triangle_at(membrane, u, f, t, scale)
        g1 = part.g1
        g2 = part.g2
        s = part.stress
        area = cut.area[t]
        ratio = g1[0] * g2[1] - g1[1] * g2[0]
        load.elastic -= (g1 * s[0] + g2 * s[2]) * by[0] + (g2 * s[1] + g1 * s[2]) * by[1]
        load.swell += area * wp.vec3(
            part.mean * (g2[1] * by[0] - g1[1] * by[1]),
            part.mean * (g1[0] * by[1] - g2[0] * by[0]),
            ratio / 3.0,
        )
        load.volume += area * ratio * u[f, 2, k] / 3.0
        load.min_area_ratio = wp.min(load.min_area_ratio, ratio)
    for e in range(cut.first_side[k], cut.first_side[k + 1]):
        corner = cut.sides[e] // 2
        t = corner // 3
        part = triangle_at(membrane, u, f, t, scale)
        s = part.stress
        by = cut.slopes[corner]
        to_next = cut.slopes[3 * t + (corner + 1) % 3]
        fair = MIN_TENSION * 0.5 * wp.max(s[0] + s[1], 0.0)
        xx = wp.max(s[0], fair) * by[0] * to_next[0]
        yy = wp.max(s[1], fair) * by[1] * to_next[1]
        link = -(xx + yy) / (1.0 + part.g1[2] * part.g1[2] + part.g2[2] * part.g2[2])
        if cut.sides[e] % 2 == 1:
            load.link_y += link
        else:
            load.link_x += link
    load.link_x = wp.max(load.link_x, 0.0)
    load.link_y = wp.max(load.link_y, 0.0)
    return load
