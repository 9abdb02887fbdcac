"""Elastic forces, gas forces and link stiffness of a membrane's nodes, as Warp functions.

Equations X1 to X3 of docs/theory/quasistatic_membrane.md, at the four corners of each cell. Single
precision, SI units, frame S.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

_MIN_DET = wp.constant(1.0e-4)
_MIN_TENSION = wp.constant(0.05)  # minimum stiffness of a link, as a fraction of the mean tension


@wp.struct
class MembraneGrid:
    """Grid and material that all membranes of one sensor share.

    `law` holds the coefficients of X2; `free` is 1 at nodes that move; `stencil` is the in-plane
    stiffness of the membrane at rest (see `stencil.py`). `rest` (3, N) are its displacements.
    """

    nx: int
    ny: int
    dx: float
    dy: float
    lambda2: float
    modulus: float
    neo_hookean: int
    poisson: float
    law_middle: float
    law_per_unit: float
    half_thickness: float
    depth: float
    law: wp.array(dtype=float)
    free: wp.array(dtype=int)
    stencil: wp.array(dtype=float)
    rest: wp.array2d(dtype=float)


@wp.struct
class NodeLoad:
    """Load of one node.

    `elastic` N; `swell` m^2, the derivative of the volume by its position; `link_x` and `link_y`
    N/m, stiffness towards +x and +y; `volume` m^3; `min_area_ratio`, minimum over the corners of
    projected to undeformed area.
    """

    elastic: wp.vec3
    swell: wp.vec3
    link_x: float
    link_y: float
    volume: float
    min_area_ratio: float


@wp.func
def node_at(membrane: MembraneGrid, u: wp.array3d(dtype=float), f: int, i: int, j: int) -> wp.vec3:
    """Return the position of a node."""
    k = i * membrane.ny + j
    return wp.vec3(
        (float(i) - 0.5 * float(membrane.nx - 1)) * membrane.dx + u[f, 0, k],
        (float(j) - 0.5 * float(membrane.ny - 1)) * membrane.dy + u[f, 1, k],
        u[f, 2, k],
    )


@wp.func
def stress(membrane: MembraneGrid, scale: float, g1: wp.vec3, g2: wp.vec3) -> wp.vec3:
    """Return the stress S11, S22, S12 times thickness, N/m, at tangents g1 and g2."""
    c11 = membrane.lambda2 * wp.dot(g1, g1)
    c22 = membrane.lambda2 * wp.dot(g2, g2)
    c12 = membrane.lambda2 * wp.dot(g1, g2)
    m = membrane.modulus * scale
    found = wp.vec3(0.0, 0.0, 0.0)
    if membrane.neo_hookean != 0:
        root = 1.0 / wp.sqrt(wp.max(c11 * c22 - c12 * c12, _MIN_DET))
        t = (root - membrane.law_middle) * membrane.law_per_unit
        q = float(0.0)
        for k in range(11):
            q = q * t + membrane.law[10 - k]
        found = wp.vec3(m - m * q * c22, m - m * q * c11, m * q * c12)
    else:
        e11 = 0.5 * (c11 - 1.0)
        e22 = 0.5 * (c22 - 1.0)
        nu = membrane.poisson
        found = wp.vec3(m * (e11 + nu * e22), m * (e22 + nu * e11), 0.5 * m * (1.0 - nu) * c12)
    return found


@wp.func
def node_load(
    membrane: MembraneGrid, u: wp.array3d(dtype=float), f: int, i: int, j: int, scale: float
) -> NodeLoad:
    """Return the load of node (i, j), summed over the corners of its cells.

    A node's force depends on three corners of each cell: its own, and the two at the ends of its
    edges.
    """
    load = NodeLoad()
    w = 0.25 * membrane.dx * membrane.dy
    force = wp.vec3(0.0, 0.0, 0.0)
    swell = wp.vec3(0.0, 0.0, 0.0)
    link_x = float(0.0)
    link_y = float(0.0)
    volume = float(0.0)
    area_ratio = float(1.0e3)
    a = node_at(membrane, u, f, i, j)
    for e in range(4):
        si = 1 - 2 * (e // 2)
        sj = 1 - 2 * (e % 2)
        ii = i + si
        jj = j + sj
        if ii >= 0 and ii < membrane.nx and jj >= 0 and jj < membrane.ny:
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
            area_ratio = wp.min(area_ratio, t_a)
            swell += w * wp.vec3(
                a[2] * (g1[1] * sy - g2[1] * sx) - b[2] * h2[1] * sx + d[2] * h1[1] * sy,
                a[2] * (g2[0] * sx - g1[0] * sy) + b[2] * h2[0] * sx - d[2] * h1[0] * sy,
                t_a,
            )
            min_link = _MIN_TENSION * 0.5 * wp.max(s[0] + s[1], 0.0)
            flat = 1.0 / (1.0 + g1[2] * g1[2] + g2[2] * g2[2])
            if si > 0:
                flat_b = 1.0 / (1.0 + g1[2] * g1[2] + h2[2] * h2[2])
                link_x += (
                    (wp.max(s[0], min_link) * flat + wp.max(sb[0], min_link) * flat_b) * sx * sx
                )
            if sj > 0:
                flat_d = 1.0 / (1.0 + h1[2] * h1[2] + g2[2] * g2[2])
                link_y += (
                    (wp.max(s[1], min_link) * flat + wp.max(sd[1], min_link) * flat_d) * sy * sy
                )
    load.elastic = force
    load.swell = swell
    load.link_x = link_x
    load.link_y = link_y
    load.volume = volume
    load.min_area_ratio = area_ratio
    return load
