"""Equilibrium of one membrane on its obstacles, by one block of threads.

An outer iteration evaluates exact forces and obstacles, relaxes the heights against the obstacles,
then relaxes the in-plane displacements (X1 to X4 of docs/theory/quasistatic_membrane.md). The
relaxation matrices affect convergence only.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.assembly import evaluate, prepare_heights, prepare_plane
from mjtactile.warp.device.edges import find_springs
from mjtactile.warp.device.fields import Fields, Scheme
from mjtactile.warp.device.gas import Gas
from mjtactile.warp.device.grid import MembraneGrid
from mjtactile.warp.device.lowest_obstacle import has_thin_obstacle
from mjtactile.warp.device.obstacles import Geom, is_on
from mjtactile.warp.device.relaxation import relax_heights, relax_plane, synchronize

wp.set_module_options({"enable_backward": False})

CONVERGED, NOT_CONVERGED, RIM_CONTACT, GLASS_CONTACT, INVERTED, NUMERICAL_FAILURE = range(6)
"""Status of a solution: the first values of `mjtactile.quasistatic.MembraneStatus`."""

_NOT_CONVERGED = wp.constant(NOT_CONVERGED)
_GLASS = wp.constant(GLASS_CONTACT)
_INVERTED = wp.constant(INVERTED)
_NUMERICAL = wp.constant(NUMERICAL_FAILURE)
_MIN_TURN = wp.constant(0.05)  # minimum ratio of a cell's projected area
_MAX_SHIFT = wp.constant(5.0e-4)  # maximum in-plane step, m
_MIN_GAIN = wp.constant(0.2)  # minimum share of a step of the heights
_MAX_LAST = wp.constant(1.0e-3)  # step at the end of a solution above which it diverges, m


@wp.func
def move_plane(membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int) -> float:
    """Add the in-plane step, limited in length; return its length, m."""
    longest = float(0.0)
    for k in range(lane, membrane.nx * membrane.ny, threads):
        longest = wp.max(longest, wp.max(wp.abs(fields.rx[f, k]), wp.abs(fields.ry[f, k])))
    longest = wp.tile_extract(wp.tile_max(wp.tile(longest)), 0)
    by = wp.min(1.0, _MAX_SHIFT / wp.max(longest, 1.0e-12))
    for k in range(lane, membrane.nx * membrane.ny, threads):
        fields.u[f, 0, k] += by * fields.rx[f, k]
        fields.u[f, 1, k] += by * fields.ry[f, k]
    synchronize()
    return longest


@wp.func
def gain_of_step(
    membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int, gain: float
) -> float:
    """Return the share of the present step of the heights to take.

    Aitken's relaxation (Irons and Tuck 1969) compares it with the step before, of which the share
    `gain` was taken. Where the membrane is steep, its links are too soft: full steps would
    alternate and never end.
    """
    along = float(0.0)
    square = float(0.0)
    for k in range(lane, membrane.nx * membrane.ny, threads):
        difference = fields.change[f, k] - fields.step_before[f, k]
        along += fields.step_before[f, k] * difference
        square += difference * difference
    along = wp.tile_extract(wp.tile_sum(wp.tile(along)), 0)
    square = wp.tile_extract(wp.tile_sum(wp.tile(square)), 0)
    return wp.clamp(-gain * along / wp.max(square, 1.0e-20), _MIN_GAIN, 1.0)


@wp.func
def move_heights(
    membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int, gain: float
) -> float:
    """Add the share `gain` of the step of the heights; return the step's maximum, m."""
    longest = float(0.0)
    for k in range(lane, membrane.nx * membrane.ny, threads):
        step = fields.change[f, k]
        fields.u[f, 2, k] += gain * step
        fields.step_before[f, k] = step
        longest = wp.max(longest, wp.abs(step))
    longest = wp.tile_extract(wp.tile_max(wp.tile(longest)), 0)
    synchronize()
    return longest


@wp.func
def lies_on_glass(membrane: MembraneGrid, fields: Fields, f: int, lane: int, threads: int) -> bool:
    """Return true for obstacles that reach the glass. Below its rim, the frame carries them."""
    found = float(0.0)
    for k in range(lane, membrane.nx * membrane.ny, threads):
        h = fields.height[f, k]
        if is_on(h) and h - membrane.half_thickness <= -membrane.depth:
            found = 1.0
    return wp.tile_extract(wp.tile_max(wp.tile(found)), 0) > 0.0


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
    membrane: MembraneGrid,
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
            membrane.nx,
            membrane.ny,
            scheme.relaxation_z,
            scheme.sweeps_z,
            now - p,
            membrane.free,
            fields.change,
            fields.gap,
            fields.swell,
            fields.link_x,
            fields.link_y,
            fields.rz,
            fields.force,
        )
        swelled = float(0.0)
        for k in range(lane, membrane.nx * membrane.ny, threads):
            swelled += fields.swell[f, k] * fields.change[f, k]
        swelled = wp.tile_extract(wp.tile_sum(wp.tile(swelled)), 0)
        now = gas_pressure(gas, f, volume + swelled, now, scheme.bulge)
    return now


@wp.func
def solve(
    membrane: MembraneGrid,
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
    """Solve for the equilibrium of membrane `f` from its present state, and return the status.

    A solution that fails leaves the last good state. After two failures in a row, solutions start
    from rest without contact.
    """
    count = membrane.nx * membrane.ny
    p = fields.pressure[f]
    has_thin = has_thin_obstacle(membrane, geoms, f)
    if fields.lost[f] > 1:
        for k in range(lane, count, threads):
            fields.force[f, k] = 0.0
            for c in range(3):
                fields.u[f, c, k] = membrane.rest[c, k]
        synchronize()
    status = int(_NOT_CONVERGED)
    used = int(0)
    gain = fields.gain[f]
    volume = fields.volume[f]
    for step in range(scheme.outer):
        if status == _NOT_CONVERGED:
            sums = evaluate(membrane, geoms, pool, fields, f, lane, threads, scale, has_thin)
            volume = sums[0]
            before = p
            if step == 0:
                if lies_on_glass(membrane, fields, f, lane, threads):
                    status = _GLASS
            if sums[1] < _MIN_TURN:
                status = _INVERTED
            find_springs(membrane, geoms, pool, fields, f, lane, threads, has_thin)
            prepare_heights(membrane, fields, f, lane, threads, p)
            p = settle_heights(membrane, scheme, gas, fields, f, lane, threads, volume, p)
            moved_gas = wp.abs(p - before)
            if step > 0:
                gain = gain_of_step(membrane, fields, f, lane, threads, gain)
            p = before + gain * (p - before)
            last = move_heights(membrane, fields, f, lane, threads, gain)
            if scheme.sweeps_xy > 0:
                prepare_plane(membrane, fields, f, lane, threads, p, scale)
                relax_plane(
                    f,
                    lane,
                    membrane.nx,
                    membrane.ny,
                    scheme.relaxation_xy,
                    scheme.sweeps_xy,
                    scale,
                    membrane.free,
                    membrane.stencil,
                    fields.extra,
                    fields.rx,
                    fields.ry,
                )
                last = wp.max(last, move_plane(membrane, fields, f, lane, threads))
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
                fields.kept[f, c, k] = fields.u[f, c, k]
            else:
                fields.u[f, c, k] = fields.kept[f, c, k]
    if lane == 0:
        fields.iterations[f] = used
        fields.status[f] = status
        fields.lost[f] = wp.where(good, 0, fields.lost[f] + 1)
        fields.gain[f] = wp.where(good, gain, 1.0)
        if good:
            fields.pressure[f] = p
            fields.volume[f] = volume
    synchronize()
    return status


@wp.kernel
def solve_all(
    membrane: MembraneGrid,
    scheme: Scheme,
    gas: Gas,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    modulus: wp.array(dtype=float),
    fields: Fields,
):
    f, lane = wp.tid()
    solve(membrane, scheme, gas, geoms, pool, fields, f, lane, wp.block_dim(), modulus[f])
