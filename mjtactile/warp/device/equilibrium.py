"""Equilibrium of one membrane on its obstacles, by one block of threads.

An outer iteration evaluates exact forces and obstacles, relaxes the heights against the obstacles,
then relaxes the in-plane displacements (X1 to X4 of docs/theory/quasistatic_membrane.md). The
relaxation matrices affect convergence only.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.elasticity import Sheet, node_at, node_load
from mjtactile.warp.device.obstacles import MISS, Geom, is_on, obstacle_height
from mjtactile.warp.device.relaxation import relax_heights, relax_plane, synchronize

wp.set_module_options({"enable_backward": False})

CONVERGED, NOT_CONVERGED, RIM_CONTACT, GLASS_CONTACT, INVERTED, NUMERICAL_FAILURE = range(6)
"""Status of a solution: the first values of `mjtactile.quasistatic.MembraneStatus`."""

_NOT_CONVERGED = wp.constant(NOT_CONVERGED)
_RIM = wp.constant(RIM_CONTACT)
_GLASS = wp.constant(GLASS_CONTACT)
_INVERTED = wp.constant(INVERTED)
_NUMERICAL = wp.constant(NUMERICAL_FAILURE)
_CORRECTION = wp.constant(1.0 / 24.0)  # factor of X4, round obstacles
_HALVINGS = wp.constant(12)  # of a spacing, to find an edge
_NEAREST_EDGE = wp.constant(0.95)
_MIN_TURN = wp.constant(0.05)  # minimum ratio of a cell's projected area
_MAX_SHIFT = wp.constant(5.0e-4)  # maximum in-plane step, m
_MAX_LAST = wp.constant(1.0e-3)  # step at the end of a solution above which it diverges, m
_MAX_TREND = wp.constant(2.0)


@wp.struct
class Scheme:
    """Iteration: numbers of outer steps and sweeps, relaxation factors, tolerance, m."""

    outer: int
    batches: int
    sweeps_z: int
    sweeps_xy: int
    relaxation_z: float
    relaxation_xy: float
    tolerance: float
    bulge: float  # dV/dp of the free bulge, m^3/Pa
    trend: int


@wp.struct
class Fields:
    """State and workspace of all membranes: (F, 3, N), (F, N) and (F, 4, N) for N nodes."""

    u: wp.array3d(dtype=float)
    kept: wp.array3d(dtype=float)
    force: wp.array2d(dtype=float)
    kept_force: wp.array2d(dtype=float)
    height: wp.array2d(dtype=float)
    slope_x: wp.array2d(dtype=float)
    slope_y: wp.array2d(dtype=float)
    owner: wp.array2d(dtype=int)
    gap: wp.array2d(dtype=float)
    change: wp.array2d(dtype=float)
    link_x: wp.array2d(dtype=float)
    link_y: wp.array2d(dtype=float)
    rx: wp.array2d(dtype=float)
    ry: wp.array2d(dtype=float)
    rz: wp.array2d(dtype=float)
    swell: wp.array2d(dtype=float)
    trend: wp.array3d(dtype=float)
    extra: wp.array2d(dtype=float)
    spring: wp.array3d(dtype=float)
    pressure: wp.array(dtype=float)
    volume: wp.array(dtype=float)
    status: wp.array(dtype=int)
    iterations: wp.array(dtype=int)
    lost: wp.array(dtype=int)


@wp.struct
class Gas:
    """Gas of all membranes: p V^gamma, or the gauge pressure, Pa, where not sealed; flat volume."""

    amount: wp.array(dtype=float)
    sealed: wp.array(dtype=int)
    flat: float
    ambient: float
    exponent: float


@wp.func
def _lowest(
    sheet: Sheet,
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
            found = obstacle_height(geom, pool, sheet.half_thickness, x, y)
            if found[0] < best[0]:
                best = wp.vec4(found[0], found[1], found[2], float(g))
    return best


@wp.func
def _edge_spring(
    sheet: Sheet,
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
                middle = 0.5 * (low + high)
                x = a + middle * (b - a)
                at = _lowest(sheet, geoms, pool, f, x[0], x[1])
                if is_on(at[0]):
                    low = middle
                else:
                    high = middle
            share = wp.min(low, _NEAREST_EDGE)
            spring = wp.max(link, 0.0) * share / (1.0 - share)
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
def _along(sheet: Sheet, fields: Fields, f: int, k: int, side: int) -> float:
    """Return the height that the face at a node gains up to its neighbor."""
    rise = fields.slope_x[f, k] * sheet.dx
    if side > 1:
        rise = fields.slope_y[f, k] * sheet.dy
    return rise * (1.0 - 2.0 * float(side % 2))


@wp.func
def _bend(center: float, one: float, other: float) -> float:
    found = float(0.0)
    if is_on(one) and is_on(other):
        found = one + other - 2.0 * center
    return found


@wp.func
def _height_correction(sheet: Sheet, fields: Fields, f: int, k: int) -> float:
    """Return the height by which a round obstacle is lowered at an inner node (X4), m."""
    h = fields.height[f, k]
    bend = _bend(h, fields.height[f, k - sheet.ny], fields.height[f, k + sheet.ny])
    bend += _bend(h, fields.height[f, k - 1], fields.height[f, k + 1])
    sx = fields.slope_x[f, k]
    sy = fields.slope_y[f, k]
    steep = 1.0 + sx * sx + sy * sy
    return _CORRECTION * wp.max(bend, 0.0) / (steep * wp.sqrt(steep))


@wp.func
def evaluate(
    sheet: Sheet,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    lane: int,
    threads: int,
    scale: float,
) -> wp.vec2:
    """Evaluate forces, links and obstacles at all nodes; return volume and minimum turn."""
    volume = float(0.0)
    turn = float(1.0e3)
    count = sheet.nx * sheet.ny
    for k in range(lane, count, threads):
        i = k // sheet.ny
        j = k - i * sheet.ny
        load = node_load(sheet, fields.u, f, i, j, scale)
        volume += load.volume
        turn = wp.min(turn, load.turn)
        fields.rz[f, k] = load.elastic[2]
        fields.swell[f, k] = load.swell[2]
        fields.link_x[f, k] = load.link_x
        fields.link_y[f, k] = load.link_y
        x = node_at(sheet, fields.u, f, i, j)
        seen = _lowest(sheet, geoms, pool, f, x[0], x[1])
        fields.height[f, k] = seen[0]
        fields.slope_x[f, k] = seen[1]
        fields.slope_y[f, k] = seen[2]
        fields.owner[f, k] = int(seen[3])
    total = wp.tile_extract(wp.tile_sum(wp.tile(volume)), 0)
    lowest = wp.tile_extract(wp.tile_min(wp.tile(turn)), 0)
    synchronize()
    return wp.vec2(total, lowest)


@wp.func
def find_springs(
    sheet: Sheet,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    lane: int,
    threads: int,
) -> None:
    """Compute the springs of X4 at edges, towards +x, -x, +y and -y of each touching node."""
    for k in range(lane, sheet.nx * sheet.ny, threads):
        i = k // sheet.ny
        j = k - i * sheet.ny
        touches = sheet.free[k] != 0 and fields.force[f, k] > 0.0
        for side in range(4):
            spring = float(0.0)
            if touches:
                other = k + _side_step(side, sheet.ny)
                link = fields.link_x[f, k]
                if side == 1:
                    link = fields.link_x[f, k - sheet.ny]
                elif side == 2:
                    link = fields.link_y[f, k]
                elif side == 3:
                    link = fields.link_y[f, k - 1]
                a = node_at(sheet, fields.u, f, i, j)
                b = node_at(sheet, fields.u, f, other // sheet.ny, other % sheet.ny)
                along = _along(sheet, fields, f, k, side)
                spring = _edge_spring(sheet, geoms, pool, fields, f, k, a, other, b, along, link)
            fields.spring[f, side, k] = spring
    synchronize()


@wp.func
def prepare_heights(
    sheet: Sheet, fields: Fields, f: int, lane: int, threads: int, p: float
) -> None:
    """Add gas and springs to residual and links, and compute the room below the obstacles."""
    ny = sheet.ny
    for k in range(lane, sheet.nx * ny, threads):
        i = k // ny
        j = k - i * ny
        r = fields.rz[f, k] + p * fields.swell[f, k]
        gap = float(MISS)
        z = fields.u[f, 2, k]
        if sheet.free[k] != 0:
            for side in range(4):
                other = k + _side_step(side, ny)
                own = fields.spring[f, side, k]
                if own > 0.0:
                    r += own * (fields.u[f, 2, other] - z - _along(sheet, fields, f, k, side))
                back = side + 1 - 2 * (side % 2)
                theirs = fields.spring[f, back, other]
                if theirs > 0.0:
                    r -= theirs * (
                        z - fields.u[f, 2, other] - _along(sheet, fields, f, other, back)
                    )
            h = fields.height[f, k]
            if is_on(h):
                gap = h - _height_correction(sheet, fields, f, k) - z
        fields.rz[f, k] = r
        fields.gap[f, k] = gap
        fields.change[f, k] = 0.0
    synchronize()
    for k in range(lane, sheet.nx * ny, threads):
        i = k // ny
        j = k - i * ny
        if i < sheet.nx - 1:
            fields.link_x[f, k] += fields.spring[f, 0, k] + fields.spring[f, 1, k + ny]
        if j < ny - 1:
            fields.link_y[f, k] += fields.spring[f, 2, k] + fields.spring[f, 3, k + 1]
    synchronize()


@wp.func
def prepare_plane(
    sheet: Sheet, fields: Fields, f: int, lane: int, threads: int, p: float, scale: float
) -> None:
    """Compute the in-plane residual with the push of the obstacles, and its stiffness."""
    ny = sheet.ny
    for k in range(lane, sheet.nx * ny, threads):
        i = k // ny
        j = k - i * ny
        rx = float(0.0)
        ry = float(0.0)
        extra = float(0.0)
        if sheet.free[k] != 0:
            load = node_load(sheet, fields.u, f, i, j, scale)
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


@wp.func
def extrapolate(sheet: Sheet, fields: Fields, f: int, lane: int, threads: int) -> float:
    """Continue the last change of the membrane by the factor that fits the motion of the obstacles.

    Return the factor; 0 if the last change explains less than half of the gaps.
    """
    along = float(0.0)
    trends = float(0.0)
    gaps = float(0.0)
    for k in range(lane, sheet.nx * sheet.ny, threads):
        h = fields.height[f, k]
        if fields.force[f, k] > 0.0 and is_on(h):
            gap = h - _height_correction(sheet, fields, f, k) - fields.u[f, 2, k]
            went = (
                fields.trend[f, 2, k]
                - fields.slope_x[f, k] * fields.trend[f, 0, k]
                - fields.slope_y[f, k] * fields.trend[f, 1, k]
            )
            along += gap * went
            trends += went * went
            gaps += gap * gap
    along = wp.tile_extract(wp.tile_sum(wp.tile(along)), 0)
    trends = wp.tile_extract(wp.tile_sum(wp.tile(trends)), 0)
    gaps = wp.tile_extract(wp.tile_sum(wp.tile(gaps)), 0)
    by = float(0.0)
    if trends > 1.0e-16:
        share = along / trends
        if wp.abs(share) < _MAX_TREND and along * share > 0.5 * gaps:
            by = share
    if by != 0.0:
        for k in range(lane, sheet.nx * sheet.ny, threads):
            for c in range(3):
                fields.u[f, c, k] += by * fields.trend[f, c, k]
    synchronize()
    return by


@wp.func
def move_plane(sheet: Sheet, fields: Fields, f: int, lane: int, threads: int) -> float:
    """Add the in-plane step, limited in length; return its length, m."""
    longest = float(0.0)
    for k in range(lane, sheet.nx * sheet.ny, threads):
        longest = wp.max(longest, wp.max(wp.abs(fields.rx[f, k]), wp.abs(fields.ry[f, k])))
    longest = wp.tile_extract(wp.tile_max(wp.tile(longest)), 0)
    by = wp.min(1.0, _MAX_SHIFT / wp.max(longest, 1.0e-12))
    for k in range(lane, sheet.nx * sheet.ny, threads):
        fields.u[f, 0, k] += by * fields.rx[f, k]
        fields.u[f, 1, k] += by * fields.ry[f, k]
    synchronize()
    return longest


@wp.func
def move_heights(sheet: Sheet, fields: Fields, f: int, lane: int, threads: int) -> float:
    """Add the step of the heights; return its maximum, m."""
    longest = float(0.0)
    for k in range(lane, sheet.nx * sheet.ny, threads):
        step = fields.change[f, k]
        fields.u[f, 2, k] += step
        longest = wp.max(longest, wp.abs(step))
    longest = wp.tile_extract(wp.tile_max(wp.tile(longest)), 0)
    synchronize()
    return longest


@wp.func
def frame_status(sheet: Sheet, fields: Fields, f: int, lane: int, threads: int) -> int:
    """Return RIM_CONTACT or GLASS_CONTACT for obstacles too low there, else 0."""
    found = float(0.0)
    for k in range(lane, sheet.nx * sheet.ny, threads):
        h = fields.height[f, k]
        if is_on(h):
            if sheet.free[k] == 0 and h < -2.0 * sheet.half_thickness:
                found = wp.max(found, float(_RIM))
            if h - sheet.half_thickness <= -sheet.depth:
                found = wp.max(found, float(_GLASS))
    return int(wp.tile_extract(wp.tile_max(wp.tile(found)), 0))


@wp.func
def gas_pressure(gas: Gas, f: int, bulge: float, present: float, bulge_rate: float) -> float:
    """Return the next gauge pressure, Pa: a secant step along the response of the free bulge."""
    p = gas.amount[f]
    if gas.sealed[f] != 0:
        volume = gas.flat + bulge
        absolute = gas.amount[f] / wp.pow(volume, gas.exponent)
        stiffness = gas.exponent * absolute / volume
        p = present + (absolute - gas.ambient - present) / (1.0 + stiffness * bulge_rate)
    return p


@wp.func
def settle_heights(
    sheet: Sheet,
    scheme: Scheme,
    gas: Gas,
    fields: Fields,
    f: int,
    lane: int,
    threads: int,
    volume: float,
    p: float,
) -> float:
    """Relax the heights together with the gas; return the pressure, Pa.

    Links and forces of the rubber are those of the present outer step.
    """
    now = float(p)
    if gas.sealed[f] == 0:
        now = gas.amount[f]
    for _batch in range(scheme.batches):
        relax_heights(
            f,
            lane,
            sheet.nx,
            sheet.ny,
            scheme.relaxation_z,
            scheme.sweeps_z,
            now - p,
            sheet.free,
            fields.change,
            fields.gap,
            fields.swell,
            fields.link_x,
            fields.link_y,
            fields.rz,
            fields.force,
        )
        swelled = float(0.0)
        for k in range(lane, sheet.nx * sheet.ny, threads):
            swelled += fields.swell[f, k] * fields.change[f, k]
        swelled = wp.tile_extract(wp.tile_sum(wp.tile(swelled)), 0)
        now = gas_pressure(gas, f, volume + swelled, now, scheme.bulge)
    return now


@wp.func
def solve(
    sheet: Sheet,
    scheme: Scheme,
    gas: Gas,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    f: int,
    lane: int,
    threads: int,
    scale: float,
) -> int:
    """Bring membrane `f` to equilibrium from its present state; return the status.

    A solution that fails leaves the last good state. After two failures in a row, solutions start
    from rest without contact.
    """
    count = sheet.nx * sheet.ny
    p = fields.pressure[f]
    if fields.lost[f] > 1:
        for k in range(lane, count, threads):
            fields.force[f, k] = 0.0
            for c in range(3):
                fields.u[f, c, k] = sheet.rest[c, k]
        synchronize()
    status = int(_NOT_CONVERGED)
    used = int(0)
    volume = fields.volume[f]
    for step in range(scheme.outer):
        if status == _NOT_CONVERGED:
            sums = evaluate(sheet, geoms, pool, fields, f, lane, threads, scale)
            if step == 0:
                if scheme.trend != 0 and extrapolate(sheet, fields, f, lane, threads) != 0.0:
                    sums = evaluate(sheet, geoms, pool, fields, f, lane, threads, scale)
            volume = sums[0]
            before = p
            if step == 0:
                misplaced = frame_status(sheet, fields, f, lane, threads)
                if misplaced > 0:
                    status = misplaced
            if sums[1] < _MIN_TURN:
                status = _INVERTED
            find_springs(sheet, geoms, pool, fields, f, lane, threads)
            prepare_heights(sheet, fields, f, lane, threads, p)
            p = settle_heights(sheet, scheme, gas, fields, f, lane, threads, volume, p)
            moved_gas = wp.abs(p - before)
            last = move_heights(sheet, fields, f, lane, threads)
            if scheme.sweeps_xy > 0:
                prepare_plane(sheet, fields, f, lane, threads, p, scale)
                relax_plane(
                    f,
                    lane,
                    sheet.nx,
                    sheet.ny,
                    scheme.relaxation_xy,
                    scheme.sweeps_xy,
                    scale,
                    sheet.free,
                    sheet.stencil,
                    fields.extra,
                    fields.rx,
                    fields.ry,
                )
                last = wp.max(last, move_plane(sheet, fields, f, lane, threads))
            used += 1
            if not (wp.isfinite(last) and wp.isfinite(p) and wp.abs(volume) < gas.flat):
                status = _NUMERICAL
            elif step == scheme.outer - 1 and last > _MAX_LAST:
                status = _NUMERICAL
            elif status == _NOT_CONVERGED and last < scheme.tolerance:
                if moved_gas < 1.0e-3 * wp.abs(p) + 0.05:
                    status = 0
    good = status <= _NOT_CONVERGED
    for k in range(lane, count, threads):
        if good:
            fields.kept_force[f, k] = fields.force[f, k]
        else:
            fields.force[f, k] = fields.kept_force[f, k]
        for c in range(3):
            if good:
                fields.trend[f, c, k] = fields.u[f, c, k] - fields.kept[f, c, k]
                fields.kept[f, c, k] = fields.u[f, c, k]
            else:
                fields.trend[f, c, k] = 0.0
                fields.u[f, c, k] = fields.kept[f, c, k]
    if lane == 0:
        fields.iterations[f] = used
        fields.status[f] = status
        fields.lost[f] = wp.where(good, 0, fields.lost[f] + 1)
        if good:
            fields.pressure[f] = p
            fields.volume[f] = volume
    synchronize()
    return status


@wp.kernel
def solve_all(
    sheet: Sheet,
    scheme: Scheme,
    gas: Gas,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    modulus: wp.array(dtype=float),
    fields: Fields,
):
    f, lane = wp.tid()
    solve(sheet, scheme, gas, geoms, pool, fields, f, lane, wp.block_dim(), modulus[f])
