"""Coulomb's limit for each node of the sticking contacts on one membrane (X7).

The rules of `stick` of kernels/qs_friction.c. SI units, frame S.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.contact import Patch
from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid, node_at
from mjtactile.warp.device.relaxation import synchronize
from mjtactile.warp.device.sticking import NodeLoads, Sticking, node_of, rigid, sum_of

wp.set_module_options({"enable_backward": False})

_SWEEPS = wp.constant(8)
_MAX_WORK = wp.constant(8000)  # pairs of nodes after which no sweep starts
_CLOSE_LOAD = wp.constant(1.0e-3)  # change of a load that is ignored, over the mean limit
_AT_LIMIT = wp.constant(1.0e-6)  # relative distance from the limit that is rounding error


@wp.func
def _limit_of(
    fields: Fields,
    patches: wp.array2d(dtype=Patch),
    sticking: Sticking,
    friction: float,
    f: int,
    n: int,
    k: int,
) -> float:
    """Return the friction limit, N, of an inner node in contact."""
    limit = float(0.0)
    if patches[f, sticking.known[f, n] - 1].touches != 0:
        limit = friction * fields.force[f, k]
    return limit


@wp.func
def move_loads(
    membrane: MembraneGrid,
    sticking: Sticking,
    nodes: NodeLoads,
    along: wp.vec3,
    f: int,
    slot: int,
    lane: int,
    threads: int,
) -> None:
    """Add the loads by the motion `along` of a patch, as if all nodes stick."""
    for a in range(lane, 2 * sticking.count[f], threads):
        k = node_of(membrane, sticking.held[f, a // 2])
        for motion in range(3):
            by = nodes.unit[f, 6 * slot + 2 * motion + a % 2, k]
            nodes.load[f, a % 2, k] += along[motion] * by


@wp.func
def redistribute(
    membrane: MembraneGrid,
    fields: Fields,
    patches: wp.array2d(dtype=Patch),
    sticking: Sticking,
    nodes: NodeLoads,
    friction: float,
    f: int,
    lane: int,
    threads: int,
) -> None:
    """Move loads beyond the limits to nodes within them, by projected Gauss-Seidel sweeps."""
    count = sticking.count[f]
    mean = float(0.0)
    for a in range(lane, count, threads):
        n = sticking.held[f, a]
        k = node_of(membrane, n)
        mean += _limit_of(fields, patches, sticking, friction, f, n, k) / float(count)
    mean = sum_of(mean)
    changes = int(1)
    work = int(0)
    for _sweep in range(_SWEEPS):
        if changes > 0 and work < _MAX_WORK:
            changes = int(0)
            for a in range(count):
                n = sticking.held[f, a]
                k = node_of(membrane, n)
                C = wp.mat22(
                    sticking.compliance[2 * n, 2 * n],
                    sticking.compliance[2 * n, 2 * n + 1],
                    sticking.compliance[2 * n + 1, 2 * n],
                    sticking.compliance[2 * n + 1, 2 * n + 1],
                )
                load = wp.vec2(nodes.load[f, 0, k], nodes.load[f, 1, k])
                now = load + wp.inverse(C) @ wp.vec2(nodes.lag[f, 0, k], nodes.lag[f, 1, k])
                limit = _limit_of(fields, patches, sticking, friction, f, n, k)
                if wp.length(now) > limit:
                    now = now * (limit / wp.length(now))
                by = now - load
                if wp.abs(by[0]) + wp.abs(by[1]) > _CLOSE_LOAD * mean:
                    changes += 1
                    work += count
                    synchronize()
                    if lane == 0:
                        nodes.load[f, 0, k] = now[0]
                        nodes.load[f, 1, k] = now[1]
                    for b in range(lane, 2 * count, threads):
                        other = sticking.held[f, b // 2]
                        row = 2 * other + b % 2
                        moved = sticking.compliance[2 * n, row] * by[0]
                        moved += sticking.compliance[2 * n + 1, row] * by[1]
                        nodes.lag[f, b % 2, node_of(membrane, other)] -= moved
                    synchronize()


@wp.func
def rub(
    membrane: MembraneGrid,
    fields: Fields,
    patches: wp.array2d(dtype=Patch),
    sticking: Sticking,
    nodes: NodeLoads,
    friction: float,
    f: int,
    slot: int,
    lane: int,
    threads: int,
) -> Patch:
    """Return a patch with the loads of its nodes. It slides if each of them is at its limit."""
    found = patches[f, slot]
    shear = wp.vec3(0.0, 0.0, 0.0)
    slip = wp.vec2(0.0, 0.0)
    weight = float(0.0)
    stuck = float(0.0)
    listed = float(0.0)
    for a in range(lane, sticking.count[f], threads):
        n = sticking.held[f, a]
        if sticking.known[f, n] == slot + 1:
            k = node_of(membrane, n)
            x = node_at(membrane, fields.u, f, k // membrane.ny, k % membrane.ny)
            load = wp.vec2(nodes.load[f, 0, k], nodes.load[f, 1, k])
            limit = _limit_of(fields, patches, sticking, friction, f, n, k)
            listed += 1.0
            weight += limit
            is_stuck = wp.length(load) < (1.0 - _AT_LIMIT) * limit
            if is_stuck:
                stuck += 1.0
            for axis in range(2):
                slip[axis] += limit * nodes.lag[f, axis, k]
                if not is_stuck:
                    nodes.lag[f, axis, k] = 0.0
                for motion in range(3):
                    shear[motion] += load[axis] * rigid(x, found.middle, motion, axis)
    weight = sum_of(weight)
    stuck = sum_of(stuck)
    listed = sum_of(listed)
    shear = wp.vec3(sum_of(shear[0]), sum_of(shear[1]), sum_of(shear[2]))
    slip = wp.vec2(sum_of(slip[0]), sum_of(slip[1]))
    if found.touches != 0:
        if friction > 0.0 and listed > 0.0 and stuck == 0.0:
            found.slides = 1
            found.slid += wp.length(slip) / weight
        force = wp.vec3(shear[0], shear[1], 0.0)
        found.force += force
        found.torque += wp.cross(found.middle, force) + wp.vec3(0.0, 0.0, shear[2])
    return found
