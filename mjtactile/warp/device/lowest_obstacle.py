"""Lowest obstacle over the nodes of one membrane, and obstacles thinner than the node spacing.

The rules of kernels/qs_contact_update.c (X4 of docs/theory/quasistatic_membrane.md).
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid
from mjtactile.warp.device.obstacles import (
    CONVEX,
    MISS,
    PLANE,
    SPHERE,
    Geom,
    is_on,
    obstacle_height,
)
from mjtactile.warp.device.relaxation import synchronize

wp.set_module_options({"enable_backward": False})

_THIN = wp.constant(5)  # points sampled on each side of a node for thin obstacles
_HALF_A_CELL = wp.constant(0.55)  # limit of half a cell, spacings: nodes have moved apart
_LEAN_OVER = wp.constant(0.3)  # distance for the inclination of a thin obstacle, spacings


@wp.struct
class Found:
    """Obstacle over a node: height, m, slopes, index of its geom, and offset of its center, m."""

    height: float
    slope_x: float
    slope_y: float
    owner: int
    away: wp.vec2


@wp.func
def lowest(
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
            if found[0] < best[0] and found[0] < membrane.roof:
                best = wp.vec4(found[0], found[1], found[2], float(g))
    return best


@wp.func
def is_covered(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    f: int,
    at: wp.vec2,
) -> bool:
    """Return True if an obstacle is over a point."""
    found = lowest(membrane, geoms, pool, f, at[0], at[1])
    return is_on(found[0])


@wp.func
def _is_thin(membrane: MembraneGrid, geom: Geom) -> bool:
    """Return True if a geom is narrower than the node spacing."""
    width = 2.0 * wp.min(geom.size[0], geom.size[1])
    if geom.kind == SPHERE:
        width = 2.0 * geom.size[0]
    elif geom.kind == CONVEX:
        width = wp.min(width, 2.0 * geom.size[2])
    return geom.kind >= 0 and geom.kind != PLANE and width < wp.max(membrane.dx, membrane.dy)


@wp.func
def has_thin_obstacle(membrane: MembraneGrid, geoms: wp.array2d(dtype=Geom), f: int) -> bool:
    """Return True if a geom of membrane `f` is narrower than the node spacing."""
    found = int(0)
    for g in range(geoms.shape[1]):
        if _is_thin(membrane, geoms[f, g]):
            found = 1
    return found > 0


@wp.func
def _is_near_thin(
    membrane: MembraneGrid, geoms: wp.array2d(dtype=Geom), f: int, x: float, y: float
) -> bool:
    """Return True if a thin geom may be within a spacing of a point."""
    found = int(0)
    for g in range(geoms.shape[1]):
        geom = geoms[f, g]
        if _is_thin(membrane, geom):
            reach = 2.0 * (geom.size[0] + geom.size[1] + geom.size[2] + membrane.half_thickness)
            reach += membrane.dx + membrane.dy
            if wp.length(wp.vec2(geom.p[0] - x, geom.p[1] - y)) < reach:
                found = 1
    return found > 0


@wp.func
def _reach(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    f: int,
    at: wp.vec2,
    axis: int,
) -> wp.vec2:
    """Return the extent of an obstacle along an axis from a point on it, below and above.

    The unit is a spacing over 2 _THIN + 1; extents end at a spacing.
    """
    step = wp.vec2(membrane.dx / float(2 * _THIN + 1), 0.0)
    if axis == 1:
        step = wp.vec2(0.0, membrane.dy / float(2 * _THIN + 1))
    found = wp.vec2(0.0, 0.0)
    for end in range(2):
        side = 2.0 * float(end) - 1.0
        goes_on = int(1)
        for part in range(2 * _THIN + 1):
            if goes_on > 0:
                if is_covered(membrane, geoms, pool, f, at + side * float(part + 1) * step):
                    found[end] = float(part + 1)
                else:
                    goes_on = 0
    return found


@wp.func
def _see_between(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    f: int,
    x: float,
    y: float,
) -> Found:
    """Return an obstacle that is thinner than the spacing and passes between nodes.

    It is the lowest point on the cross of the node's cell, across which it is thin.
    """
    found = Found()
    found.height = MISS
    found.owner = -1
    parts = float(2 * _THIN + 1)
    for axis in range(2):
        low = wp.vec4(found.height, 0.0, 0.0, -1.0)
        unit = wp.vec2(membrane.dx, 0.0)
        if axis == 1:
            unit = wp.vec2(0.0, membrane.dy)
        offset = float(0.0)
        at = wp.vec2(x, y)
        for part in range(-_THIN - 1, _THIN + 2):
            fraction = float(part) / parts
            here = at + fraction * unit
            seen = lowest(membrane, geoms, pool, f, here[0], here[1])
            if seen[0] < low[0]:
                low = seen
                offset = fraction
        if low[0] < found.height:
            across = _reach(membrane, geoms, pool, f, at + offset * unit, axis)
            middle = offset + 0.5 * (across[1] - across[0]) / parts
            if wp.abs(middle) <= _HALF_A_CELL:
                along = _reach(membrane, geoms, pool, f, at + middle * unit, 1 - axis)
                if across[0] + across[1] <= along[0] + along[1]:
                    found.height = low[0]
                    found.slope_x = low[1]
                    found.slope_y = low[2]
                    found.owner = int(low[3])
                    found.away = middle * unit
    return found


@wp.func
def obstacle_over(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    f: int,
    x: float,
    y: float,
    has_thin: bool,
) -> Found:
    """Return the obstacle over a node at (x, y), or a thin one next to it."""
    seen = lowest(membrane, geoms, pool, f, x, y)
    found = Found()
    found.height = seen[0]
    found.slope_x = seen[1]
    found.slope_y = seen[2]
    found.owner = int(seen[3])
    if has_thin and not is_on(seen[0]):
        if _is_near_thin(membrane, geoms, f, x, y):
            found = _see_between(membrane, geoms, pool, f, x, y)
    return found


@wp.func
def drop_repeated(membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int) -> None:
    """Remove thin obstacles that a neighbor has, and their ends next to nodes that are on them."""
    ny = membrane.ny
    for step in range(2):
        for k in range(lane, membrane.nx * ny, threads):
            drop = float(0.0)
            for axis in range(2):
                away = fields.away[f, axis, k]
                stride = ny
                if axis == 1:
                    stride = 1
                inside = membrane.free[k] > 0
                if away != 0.0 and inside:
                    if step == 0 and fields.away[f, axis, k - stride] != 0.0:
                        drop = 1.0
                    if step == 1:
                        other = k + stride
                        if away < 0.0:
                            other = k - stride
                        if is_on(fields.height[f, other]) and fields.away[f, axis, other] == 0.0:
                            drop = 1.0
            fields.gap[f, k] = drop
        synchronize()
        for k in range(lane, membrane.nx * ny, threads):
            if fields.gap[f, k] > 0.0:
                fields.height[f, k] = MISS
                fields.owner[f, k] = -1
                fields.away[f, 0, k] = 0.0
                fields.away[f, 1, k] = 0.0
        synchronize()


@wp.func
def lean(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    f: int,
    at: wp.vec2,
    axis: int,
) -> float:
    """Return the drift of a thin obstacle across an axis per distance along it, in spacings."""
    found = float(0.0)
    ends = float(0.0)
    across = _reach(membrane, geoms, pool, f, at, 1 - axis)
    if across[0] + across[1] <= float(2 * _THIN):
        along = wp.vec2(membrane.dx, 0.0)
        over = wp.vec2(0.0, membrane.dy)
        if axis == 1:
            along = wp.vec2(0.0, membrane.dy)
            over = wp.vec2(membrane.dx, 0.0)
        for end in range(2):
            side = 2.0 * float(end) - 1.0
            total = float(0.0)
            hits = float(0.0)
            for part in range(-_THIN, _THIN + 1):
                fraction = float(part) / float(2 * _THIN + 1)
                position = at + side * _LEAN_OVER * along + fraction * over
                if is_covered(membrane, geoms, pool, f, position):
                    total += fraction
                    hits += 1.0
            if hits > 0.0:
                found += side * total / hits / _LEAN_OVER
                ends += 1.0
    return found / wp.max(ends, 1.0)
