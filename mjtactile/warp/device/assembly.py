"""Forces, obstacles, links and rooms at the nodes of one membrane, for its relaxation.

Equations X1 to X4 of docs/theory/quasistatic_membrane.md.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.edges import continues, face_rise, side_step
from mjtactile.warp.device.elasticity import node_load
from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid, node_at
from mjtactile.warp.device.lowest_obstacle import drop_repeated, obstacle_over
from mjtactile.warp.device.obstacles import MISS, Geom, is_on
from mjtactile.warp.device.relaxation import synchronize

wp.set_module_options({"enable_backward": False})

_CORRECTION = wp.constant(1.0 / 24.0)  # factor of X4, round obstacles


@wp.func
def _bend(membrane: MembraneGrid, fields: Fields, f: int, k: int, axis: int) -> float:
    """Return the second difference of the obstacle's height along an axis, m, 0 at its end."""
    found = float(0.0)
    if continues(membrane, fields, f, k, 2 * axis) and continues(
        membrane, fields, f, k, 2 * axis + 1
    ):
        step = side_step(2 * axis, membrane.ny)
        found = fields.height[f, k + step] + fields.height[f, k - step]
        found -= 2.0 * fields.height[f, k]
    return found


@wp.func
def _height_correction(membrane: MembraneGrid, fields: Fields, f: int, k: int) -> float:
    """Return the height by which a round obstacle is lowered at an inner node (X4), m."""
    bend = _bend(membrane, fields, f, k, 0) + _bend(membrane, fields, f, k, 1)
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
    has_thin: bool,
) -> wp.vec2:
    """Evaluate forces, links and obstacles at all nodes. Return volume and minimum area ratio."""
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
        seen = obstacle_over(membrane, geoms, pool, f, x[0], x[1], has_thin)
        fields.height[f, k] = seen.height
        fields.slope_x[f, k] = seen.slope_x
        fields.slope_y[f, k] = seen.slope_y
        fields.owner[f, k] = seen.owner
        fields.away[f, 0, k] = seen.away[0]
        fields.away[f, 1, k] = seen.away[1]
    total = wp.tile_extract(wp.tile_sum(wp.tile(volume)), 0)
    lowest_ratio = wp.tile_extract(wp.tile_min(wp.tile(min_area_ratio)), 0)
    synchronize()
    if has_thin:
        drop_repeated(membrane, fields, f, lane, threads)
    return wp.vec2(total, lowest_ratio)


@wp.func
def prepare_heights(
    membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int, p: float
) -> None:
    """Add gas and springs to residual and links, and compute the gap below the obstacles."""
    ny = membrane.ny
    for k in range(lane, membrane.nx * ny, threads):
        i = k // ny
        j = k - i * ny
        r = fields.rz[f, k] + p * fields.swell[f, k]
        gap = float(MISS)
        z = fields.u[f, 2, k]
        if membrane.free[k] > 0:
            for side in range(4):
                other = k + side_step(side, ny)
                spring = fields.spring[f, side, k]
                if spring > 0.0:
                    r += spring * (
                        fields.u[f, 2, other] - z - face_rise(membrane, fields, f, k, side)
                    )
                back = side + 1 - 2 * (side % 2)
                theirs = fields.spring[f, back, other]
                if theirs > 0.0:
                    r -= theirs * (
                        z - fields.u[f, 2, other] - face_rise(membrane, fields, f, other, back)
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
        if membrane.free[k] > 0:
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
        fields.extra[f, k] = extra + scale * membrane.cut.held[k]
    synchronize()
