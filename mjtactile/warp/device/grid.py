"""Grid, material and stress of the membranes of one sensor. Single precision, SI units, frame S.

Equations X1, X2 and X8 of docs/theory/quasistatic_membrane.md.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

MIN_DET = wp.constant(1.0e-4)
"""Minimum determinant of the metric."""
MIN_TENSION = wp.constant(0.05)
"""Fraction of the tension below which a link is not reduced."""


@wp.struct
class CutCells:
    """Triangles (T,) of the cells that an outline cuts (X8); without them, `count` is 0.

    `whole` (N,) is 1 where the cell that starts at a node is whole. `area` m^2, `slopes` (3 T,) 1/m
    and `nodes` (3 T,), -1 if fixed, describe the corners. `corners` holds 3 t + a for each corner a
    of triangle t at a node, from `first_corner` (N + 1,) on. `sides` holds 2 (3 t + a), plus 1 for
    a link along y, for each side that adds to the links of a node, from `first_side` on. `held`
    (N,) N/m is the in-plane stiffness that triangles add at a node.
    """

    count: int
    whole: wp.array(dtype=float)
    area: wp.array(dtype=float)
    slopes: wp.array(dtype=wp.vec2)
    nodes: wp.array(dtype=int)
    first_corner: wp.array(dtype=int)
    corners: wp.array(dtype=int)
    first_side: wp.array(dtype=int)
    sides: wp.array(dtype=int)
    held: wp.array(dtype=float)


@wp.struct
class MembraneGrid:
    """Grid and material that all membranes of one sensor share.

    `law` holds the coefficients of X2. `free` is 1 at nodes that move, 0 on the frame next to them,
    -1 beyond. `stencil` is the in-plane stiffness of the membrane at rest (see `stencil.py`).
    `rest` (3, N) are its displacements. `opening` m^2 is the area of the flat membrane.
    Obstacles above `roof` m are not over a node: the membrane does not reach them.
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
    roof: float
    opening: float
    law: wp.array(dtype=float)
    free: wp.array(dtype=int)
    stencil: wp.array(dtype=float)
    rest: wp.array2d(dtype=float)
    cut: CutCells


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
        root = 1.0 / wp.sqrt(wp.max(c11 * c22 - c12 * c12, MIN_DET))
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
