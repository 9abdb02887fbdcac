"""Edges of obstacles between the nodes of one membrane: springs (X4) and contact area (X5)."""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid, node_at
from mjtactile.warp.device.lowest_obstacle import is_covered, lean, lowest
from mjtactile.warp.device.obstacles import Geom, is_on
from mjtactile.warp.device.relaxation import synchronize

wp.set_module_options({"enable_backward": False})

_HALVINGS = wp.constant(12)  # halvings of a spacing in the search for an edge
_NEAREST_EDGE = wp.constant(0.95)
# height of another obstacle above a face, spacings, from which on the face ends
_BEHIND = wp.constant(0.35)


@wp.func
def side_step(side: int, ny: int) -> int:
    """Return the offset of the neighbor at +x, -x, +y or -y."""
    step = ny
    if side == 1:
        step = -ny
    elif side == 2:
        step = 1
    elif side == 3:
        step = -1
    return step


@wp.func
def face_rise(membrane: MembraneGrid, fields: Fields, f: int, k: int, side: int) -> float:
    """Return the height that the face at a node gains up to its neighbor."""
    rise = fields.slope_x[f, k] * membrane.dx
    if side > 1:
        rise = fields.slope_y[f, k] * membrane.dy
    return rise * (1.0 - 2.0 * float(side % 2))


@wp.func
def _is_next(
    membrane: MembraneGrid,
    fields: Fields,
    f: int,
    k: int,
    owner: int,
    height: float,
    along: wp.vec2,
) -> bool:
    """Return True if an obstacle is next to node `k`, at a distance `along` x and y.

    A wall behind an edge is not: another obstacle far above the extended face.
    """
    face = fields.height[f, k] + fields.slope_x[f, k] * along[0] + fields.slope_y[f, k] * along[1]
    far = height - face > _BEHIND * wp.max(membrane.dx, membrane.dy)
    is_thin = fields.away[f, 0, k] != 0.0 or fields.away[f, 1, k] != 0.0
    return owner == fields.owner[f, k] or is_thin or not far


@wp.func
def continues(membrane: MembraneGrid, fields: Fields, f: int, k: int, side: int) -> bool:
    """Return True if the obstacle at a node continues to its neighbor."""
    other = k + side_step(side, membrane.ny)
    along = wp.vec2(membrane.dx, 0.0)
    if side > 1:
        along = wp.vec2(0.0, membrane.dy)
    along = along * (1.0 - 2.0 * float(side % 2))
    height = fields.height[f, other]
    is_thin = fields.away[f, 0, other] != 0.0 or fields.away[f, 1, other] != 0.0
    found = is_on(height)
    if found and not is_thin:
        found = _is_next(membrane, fields, f, k, fields.owner[f, other], height, along)
    return found


@wp.func
def _continues_to(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    k: int,
    at: wp.vec2,
    along: wp.vec2,
) -> bool:
    """Return True if the obstacle at node `k` continues from `at` to `at` + `along`."""
    seen = lowest(membrane, geoms, pool, f, at[0] + along[0], at[1] + along[1])
    found = is_on(seen[0])
    if found:
        found = _is_next(membrane, fields, f, k, int(seen[3]), seen[0], along)
    return found


@wp.func
def _edge(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    k: int,
    side: int,
    has_thin: bool,
) -> float:
    """Return the fraction of the link to a neighbor at which the obstacle of node `k` ends, or -1.

    -1: the obstacle continues to the neighbor, or the node is on none.
    """
    ny = membrane.ny
    other = k + side_step(side, ny)
    found = float(-1.0)
    if is_on(fields.height[f, k]) and not continues(membrane, fields, f, k, side):
        a = node_at(membrane, fields.u, f, k // ny, k % ny)
        b = node_at(membrane, fields.u, f, other // ny, other % ny)
        at = wp.vec2(a[0] + fields.away[f, 0, k], a[1] + fields.away[f, 1, k])
        link = wp.vec2(b[0] - a[0], 0.0)
        if side > 1:
            link = wp.vec2(0.0, b[1] - a[1])
        is_edge = is_covered(membrane, geoms, pool, f, at)
        if has_thin and is_edge:
            drift = (1.0 - 2.0 * float(side % 2)) * lean(membrane, geoms, pool, f, at, side // 2)
            if side > 1:
                link[0] = drift * membrane.dx
            else:
                link[1] = drift * membrane.dy
            # the obstacle continues under the next line of nodes
            is_edge = not _continues_to(membrane, geoms, pool, fields, f, k, at, link)
        if is_edge:
            low = float(0.0)
            high = float(1.0)
            for _half in range(_HALVINGS):
                midpoint = 0.5 * (low + high)
                if _continues_to(membrane, geoms, pool, fields, f, k, at, midpoint * link):
                    low = midpoint
                else:
                    high = midpoint
            found = low
    return found


@wp.func
def edges_at(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    k: int,
    has_thin: bool,
) -> wp.vec4:
    """Return the edges towards +x, -x, +y and -y of an inner node, as fractions of links, or -1."""
    found = wp.vec4(-1.0, -1.0, -1.0, -1.0)
    for side in range(4):
        found[side] = _edge(membrane, geoms, pool, fields, f, k, side, has_thin)
    # an obstacle that ends on both sides is centered about its node
    for axis in range(2):
        one = found[2 * axis]
        other = found[2 * axis + 1]
        if one >= 0.0 and other >= 0.0:
            found[2 * axis] = 0.5 * (one + other)
            found[2 * axis + 1] = 0.5 * (one + other)
    return found


@wp.func
def find_springs(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    lane: int,
    threads: int,
    has_thin: bool,
) -> None:
    """Compute the springs of X4 at edges, towards +x, -x, +y and -y of each touching node."""
    ny = membrane.ny
    for k in range(lane, membrane.nx * ny, threads):
        edges = wp.vec4(-1.0, -1.0, -1.0, -1.0)
        if membrane.free[k] > 0 and fields.force[f, k] > 0.0:
            edges = edges_at(membrane, geoms, pool, fields, f, k, has_thin)
        for side in range(4):
            spring = float(0.0)
            if edges[side] > 0.0:
                rise = fields.u[f, 2, k + side_step(side, ny)] - fields.u[f, 2, k]
                # otherwise the membrane leaves the face before the edge
                if rise - face_rise(membrane, fields, f, k, side) > 0.0:
                    link = fields.link_x[f, k]
                    if side == 1:
                        link = fields.link_x[f, k - ny]
                    elif side == 2:
                        link = fields.link_y[f, k]
                    elif side == 3:
                        link = fields.link_y[f, k - 1]
                    fraction = wp.min(edges[side], _NEAREST_EDGE)
                    spring = wp.max(link, 0.0) * fraction / (1.0 - fraction)
            fields.spring[f, side, k] = spring
    synchronize()


@wp.func
def contact_area(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    k: int,
    tension: float,
    has_thin: bool,
) -> float:
    """Return the contact area, m^2, of a node in contact (X5)."""
    ny = membrane.ny
    sx = fields.slope_x[f, k]
    sy = fields.slope_y[f, k]
    square = 1.0 + sx * sx + sy * sy
    h = fields.height[f, k]
    low_x = fields.height[f, k - ny]
    high_x = fields.height[f, k + ny]
    low_y = fields.height[f, k - 1]
    high_y = fields.height[f, k + 1]
    cell = fields.swell[f, k]
    fraction = float(1.0)
    is_covered_around = int(1)
    for side in range(4):
        if not continues(membrane, fields, f, k, side):
            is_covered_around = 0
    if is_covered_around > 0:
        bend = (low_x + high_x - 2.0 * h) / (membrane.dx * membrane.dx)
        bend += (low_y + high_y - 2.0 * h) / (membrane.dy * membrane.dy)
        full = cell * (fields.pressure[f] + tension * bend / (square * wp.sqrt(square)))
        if full > 0.0:
            fraction = wp.min(fields.force[f, k] / full, 1.0)
    else:
        wide = edges_at(membrane, geoms, pool, fields, f, k, has_thin)
        for side in range(4):
            if wide[side] < 0.0:
                wide[side] = 0.5
        fraction = (wide[0] + wide[1]) * (wide[2] + wide[3])
    return fraction * cell * wp.sqrt(square)
