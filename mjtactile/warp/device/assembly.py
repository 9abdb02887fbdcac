"""Forces, obstacles, links and rooms at the nodes of one membrane, for its relaxation.

Equations X1 to X4 of docs/theory/quasistatic_membrane.md.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.elasticity import MembraneGrid, node_at, node_load
from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.obstacles import MISS, Geom, is_on, obstacle_height
from mjtactile.warp.device.relaxation import synchronize

wp.set_module_options({"enable_backward": False})

_CORRECTION = wp.constant(1.0 / 24.0)  # factor of X4, round obstacles
_HALVINGS = wp.constant(12)  # of a spacing, to find an edge
_NEAREST_EDGE = wp.constant(0.95)


@wp.func
def _lowest(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    f: int,
    x: float,
    y: float,
) -> wp.vec4:
    """Return height, slopes and index of the lowest geom over a point."""
    best = wp.vec4(MISS, 0.0, 0.0, -1.0)
    for g in range(geoms.shape[1]):
        geom = geoms[f, g]
        if geom.kind >= 0:
            found = obstacle_height(geom, pool, membrane.half_thickness, x, y)
            if found[0] < best[0]:
                best = wp.vec4(found[0], found[1], found[2], float(g))
    return best


@wp.func
def _edge_spring(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    k: int,
    a: wp.vec3,
    other: int,
    b: wp.vec3,
    along: float,
    link: float,
) -> float:
    """Return the spring between a node on an obstacle and a neighbor beyond the obstacle's edge.

    `along` is the height that the face would gain up to the neighbor.
    """
    spring = float(0.0)
    if is_on(fields.height[f, k]) and not is_on(fields.height[f, other]):
        if b[2] - a[2] - along > 0.0:
            low = float(0.0)
            high = float(1.0)
            for _half in range(_HALVINGS):
                midpoint = 0.5 * (low + high)
                x = a + midpoint * (b - a)
                at = _lowest(membrane, geoms, pool, f, x[0], x[1])
                if is_on(at[0]):
                    low = midpoint
                else:
                    high = midpoint
            fraction = wp.min(low, _NEAREST_EDGE)
            spring = wp.max(link, 0.0) * fraction / (1.0 - fraction)
    return spring


@wp.func
def _side_step(side: int, ny: int) -> int:
    step = ny
    if side == 1:
        step = -ny
    elif side == 2:
        step = 1
    elif side == 3:
        step = -1
    return step


@wp.func
def _along(membrane: MembraneGrid, fields: Fields, f: int, k: int, side: int) -> float:
    """Return the height that the face at a node gains up to its neighbor."""
    rise = fields.slope_x[f, k] * membrane.dx
    if side > 1:
        rise = fields.slope_y[f, k] * membrane.dy
    return rise * (1.0 - 2.0 * float(side % 2))


@wp.func
def _bend(center: float, one: float, other: float) -> float:
    found = float(0.0)
    if is_on(one) and is_on(other):
        found = one + other - 2.0 * center
    return found


@wp.func
def _height_correction(membrane: MembraneGrid, fields: Fields, f: int, k: int) -> float:
    """Return the height by which a round obstacle is lowered at an inner node (X4), m."""
    h = fields.height[f, k]
    bend = _bend(h, fields.height[f, k - membrane.ny], fields.height[f, k + membrane.ny])
    bend += _bend(h, fields.height[f, k - 1], fields.height[f, k + 1])
    sx = fields.slope_x[f, k]
    sy = fields.slope_y[f, k]
    steep = 1.0 + sx * sx + sy * sy
    return _CORRECTION * wp.max(bend, 0.0) / (steep * wp.sqrt(steep))


@wp.func
def evaluate(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    lane: int,
    threads: int,
    scale: float,
) -> wp.vec2:
    """Evaluate forces, links and obstacles at all nodes; return volume and minimum area ratio."""
    volume = float(0.0)
    min_area_ratio = float(1.0e3)
    count = membrane.nx * membrane.ny
    for k in range(lane, count, threads):
        i = k // membrane.ny
        j = k - i * membrane.ny
        load = node_load(membrane, fields.u, f, i, j, scale)
        volume += load.volume
        min_area_ratio = wp.min(min_area_ratio, load.min_area_ratio)
        fields.rz[f, k] = load.elastic[2]
        fields.swell[f, k] = load.swell[2]
        fields.link_x[f, k] = load.link_x
        fields.link_y[f, k] = load.link_y
        x = node_at(membrane, fields.u, f, i, j)
        seen = _lowest(membrane, geoms, pool, f, x[0], x[1])
        fields.height[f, k] = seen[0]
        fields.slope_x[f, k] = seen[1]
        fields.slope_y[f, k] = seen[2]
        fields.owner[f, k] = int(seen[3])
    total = wp.tile_extract(wp.tile_sum(wp.tile(volume)), 0)
    lowest = wp.tile_extract(wp.tile_min(wp.tile(min_area_ratio)), 0)
    synchronize()
    return wp.vec2(total, lowest)


@wp.func
def find_springs(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    lane: int,
    threads: int,
) -> None:
    """Compute the springs of X4 at edges, towards +x, -x, +y and -y of each touching node."""
    for k in range(lane, membrane.nx * membrane.ny, threads):
        i = k // membrane.ny
        j = k - i * membrane.ny
        touches = membrane.free[k] != 0 and fields.force[f, k] > 0.0
        for side in range(4):
            spring = float(0.0)
            if touches:
                other = k + _side_step(side, membrane.ny)
                link = fields.link_x[f, k]
                if side == 1:
                    link = fields.link_x[f, k - membrane.ny]
                elif side == 2:
                    link = fields.link_y[f, k]
                elif side == 3:
                    link = fields.link_y[f, k - 1]
                a = node_at(membrane, fields.u, f, i, j)
                b = node_at(membrane, fields.u, f, other // membrane.ny, other % membrane.ny)
                along = _along(membrane, fields, f, k, side)
                spring = _edge_spring(membrane, geoms, pool, fields, f, k, a, other, b, along, link)
            fields.spring[f, side, k] = spring
    synchronize()


@wp.func
def prepare_heights(
    membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int, p: float
) -> None:
    """Add gas and springs to residual and links, and compute the room below the obstacles."""
    ny = membrane.ny
    for k in range(lane, membrane.nx * ny, threads):
        i = k // ny
        j = k - i * ny
        r = fields.rz[f, k] + p * fields.swell[f, k]
        gap = float(MISS)
        z = fields.u[f, 2, k]
        if membrane.free[k] != 0:
            for side in range(4):
                other = k + _side_step(side, ny)
                own = fields.spring[f, side, k]
                if own > 0.0:
                    r += own * (fields.u[f, 2, other] - z - _along(membrane, fields, f, k, side))
                back = side + 1 - 2 * (side % 2)
                theirs = fields.spring[f, back, other]
                if theirs > 0.0:
                    r -= theirs * (
                        z - fields.u[f, 2, other] - _along(membrane, fields, f, other, back)
                    )
            h = fields.height[f, k]
            if is_on(h):
                gap = h - _height_correction(membrane, fields, f, k) - z
        fields.rz[f, k] = r
        fields.gap[f, k] = gap
        fields.change[f, k] = 0.0
    synchronize()
    for k in range(lane, membrane.nx * ny, threads):
        i = k // ny
        j = k - i * ny
        if i < membrane.nx - 1:
            fields.link_x[f, k] += fields.spring[f, 0, k] + fields.spring[f, 1, k + ny]
        if j < ny - 1:
            fields.link_y[f, k] += fields.spring[f, 2, k] + fields.spring[f, 3, k + 1]
    synchronize()


@wp.func
def prepare_plane(
    membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int, p: float, scale: float
) -> None:
    """Compute the in-plane residual with the push of the obstacles, and its stiffness."""
    ny = membrane.ny
    for k in range(lane, membrane.nx * ny, threads):
        i = k // ny
        j = k - i * ny
        rx = float(0.0)
        ry = float(0.0)
        extra = float(0.0)
        if membrane.free[k] != 0:
            load = node_load(membrane, fields.u, f, i, j, scale)
            push = load.elastic + p * load.swell
            q = fields.force[f, k]
            rx = push[0] + q * fields.slope_x[f, k]
            ry = push[1] + q * fields.slope_y[f, k]
            if q > 0.0:
                d = fields.link_x[f, k] + fields.link_x[f, k - ny]
                d += fields.link_y[f, k] + fields.link_y[f, k - 1]
                sx = fields.slope_x[f, k]
                sy = fields.slope_y[f, k]
                extra = d * (sx * sx + sy * sy)
        fields.rx[f, k] = rx
        fields.ry[f, k] = ry
        fields.extra[f, k] = extra
    synchronize()
