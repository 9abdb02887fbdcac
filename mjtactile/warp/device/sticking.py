"""In-plane stiffness of sticking patches on one membrane (X7), by conjugate gradients.

The rules of `find_grip` of kernels/qs_friction.c: the nodes of a patch move as one rigid set, those
of other patches are held, and all others go to equilibrium at free heights. SI units, frame S.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid, node_at
from mjtactile.warp.device.relaxation import synchronize

wp.set_module_options({"enable_backward": False})

_STEPS = wp.constant(100)  # maximum steps of the conjugate gradients
# squared residual of a stiffness, over that of the start: 0.1 % of the stiffness, quadratic in it
_CLOSE = wp.constant(1.0e-4)


@wp.struct
class NodeLoads:
    """Loads of the nodes of all membranes (F,) by their contacts.

    `load` (F, 2, N), N, along x and y; `lag` (F, 2, N), m, of the node behind its body; `unit`
    (F, 6 slots, N), loads by unit motions of the patches.
    """

    load: wp.array3d(dtype=float)
    lag: wp.array3d(dtype=float)
    unit: wp.array3d(dtype=float)


@wp.struct
class Sticking:
    """Compliance of the inner nodes, and workspace of all membranes (F,).

    `compliance` (2 I, 2 I) m/N holds x and y of each inner node in turn. `loads`, `residual`,
    `direction` and `moved` are (F, 2 I). `held` (F, I) are the inner nodes in contact, `count` is
    their number. `known` (F, I) is the patch of each inner node at the last stiffness, plus one.
    `stale` is 1 if the stiffness must be computed again.
    """

    compliance: wp.array2d(dtype=float)
    loads: wp.array2d(dtype=float)
    residual: wp.array2d(dtype=float)
    direction: wp.array2d(dtype=float)
    moved: wp.array2d(dtype=float)
    held: wp.array2d(dtype=int)
    known: wp.array2d(dtype=int)
    count: wp.array(dtype=int)
    stale: wp.array(dtype=int)


@wp.func
def node_of(membrane: MembraneGrid, inner: int) -> int:
    """Return the node of an inner node."""
    rows = membrane.ny - 2
    return (inner // rows + 1) * membrane.ny + inner % rows + 1


@wp.func
def patch_of(fields: Fields, slot_of: wp.array2d(dtype=int), f: int, finger: int, k: int) -> int:
    """Return the patch of a node in contact, plus one, or 0."""
    found = int(0)
    if fields.force[f, k] > 0.0 and fields.owner[f, k] >= 0:
        found = slot_of[finger, fields.owner[f, k]] + 1
    return found


@wp.func
def list_held(
    membrane: MembraneGrid,
    fields: Fields,
    sticking: Sticking,
    slot_of: wp.array2d(dtype=int),
    f: int,
    finger: int,
    lane: int,
) -> None:
    """List the inner nodes in contact, and compare them with those of the last stiffness."""
    if lane == 0:
        inner = (membrane.nx - 2) * (membrane.ny - 2)
        count = int(0)
        differ = int(0)
        for n in range(inner):
            patch = patch_of(fields, slot_of, f, finger, node_of(membrane, n))
            if patch > 0:
                sticking.held[f, count] = n
                count += 1
            if patch != sticking.known[f, n]:
                differ += 1
        sticking.count[f] = count
        # one node at the border of 20 has 3 % of the torsional stiffness, one of four has 20 %
        sticking.stale[f] = wp.where(differ > 0, 1, 0)
        if sticking.stale[f] != 0:
            for n in range(inner):
                sticking.known[f, n] = patch_of(fields, slot_of, f, finger, node_of(membrane, n))
    synchronize()


@wp.func
def moved_by(sticking: Sticking, values: wp.array2d(dtype=float), f: int, row: int) -> float:
    """Return the displacement `row` by forces on the nodes in contact."""
    total = float(0.0)
    for h in range(sticking.count[f]):
        n = 2 * sticking.held[f, h]
        total += sticking.compliance[n, row] * values[f, n]
        total += sticking.compliance[n + 1, row] * values[f, n + 1]
    return total


@wp.func
def sum_of(value: float) -> float:
    return wp.tile_extract(wp.tile_sum(wp.tile(value)), 0)


@wp.func
def start_from(sticking: Sticking, f: int, row: int, moved: float) -> None:
    """Write the displacement of a node in contact for `find_loads`."""
    sticking.loads[f, row] = 0.0
    sticking.residual[f, row] = moved
    sticking.direction[f, row] = moved


@wp.func
def find_loads(sticking: Sticking, f: int, lane: int, threads: int, close: float) -> None:
    """Find the `loads` on the nodes in contact that give their displacements, by `start_from`."""
    size = 2 * sticking.count[f]
    square = float(0.0)
    for a in range(lane, size, threads):
        row = 2 * sticking.held[f, a // 2] + a % 2
        square += sticking.residual[f, row] * sticking.residual[f, row]
    square = sum_of(square)
    limit = close * square
    for _step in range(_STEPS):
        if square > limit:
            synchronize()
            curved = float(0.0)
            for a in range(lane, size, threads):
                row = 2 * sticking.held[f, a // 2] + a % 2
                sticking.moved[f, row] = moved_by(sticking, sticking.direction, f, row)
                curved += sticking.moved[f, row] * sticking.direction[f, row]
            by = square / wp.max(sum_of(curved), 1.0e-30)
            after = float(0.0)
            for a in range(lane, size, threads):
                row = 2 * sticking.held[f, a // 2] + a % 2
                sticking.loads[f, row] += by * sticking.direction[f, row]
                sticking.residual[f, row] -= by * sticking.moved[f, row]
                after += sticking.residual[f, row] * sticking.residual[f, row]
            after = sum_of(after)
            for a in range(lane, size, threads):
                row = 2 * sticking.held[f, a // 2] + a % 2
                new = sticking.residual[f, row] + after / square * sticking.direction[f, row]
                sticking.direction[f, row] = new
            square = after
    synchronize()


@wp.func
def rigid(x: wp.vec3, middle: wp.vec3, motion: int, axis: int) -> float:
    """Return the displacement along an axis of a point by a unit motion: x, y, rotation."""
    found = float(0.0)
    if motion == axis:
        found = 1.0
    elif motion == 2:
        found = x[0] - middle[0]
        if axis == 0:
            found = middle[1] - x[1]
    return found


@wp.func
def keep_loads(
    membrane: MembraneGrid, sticking: Sticking, nodes: NodeLoads, f: int, lane: int, threads: int
) -> None:
    """Find the loads of the present contact that keep the displacements of its nodes.

    A node joins without a load: the others displaced it before. The others take over the loads of
    nodes that leave.
    """
    inner = (membrane.nx - 2) * (membrane.ny - 2)
    for a in range(lane, 2 * sticking.count[f], threads):
        n = sticking.held[f, a // 2]
        row = 2 * n + a % 2
        moved = nodes.lag[f, a % 2, node_of(membrane, n)]
        for other in range(inner):
            if sticking.known[f, other] == 0:
                k = node_of(membrane, other)
                moved += sticking.compliance[2 * other, row] * nodes.load[f, 0, k]
                moved += sticking.compliance[2 * other + 1, row] * nodes.load[f, 1, k]
        start_from(sticking, f, row, moved)
    find_loads(sticking, f, lane, threads, _CLOSE)
    for n in range(lane, inner, threads):
        k = node_of(membrane, n)
        for axis in range(2):
            now = float(0.0)
            if sticking.known[f, n] != 0:
                now = nodes.load[f, axis, k] + sticking.loads[f, 2 * n + axis]
            nodes.load[f, axis, k] = now
            nodes.lag[f, axis, k] = 0.0
    synchronize()


@wp.func
def grip_of(
    membrane: MembraneGrid,
    fields: Fields,
    sticking: Sticking,
    slot_of: wp.array2d(dtype=int),
    f: int,
    finger: int,
    slot: int,
    middle: wp.vec3,
    lane: int,
    threads: int,
    nodes: NodeLoads,
) -> wp.mat33:
    """Return the stiffness of a patch: x, y, and rotation about its center. N/m, N, N m/rad.

    Store the loads by unit motions in `nodes`.
    """
    found = wp.mat33()
    for motion in range(3):
        for k in range(lane, membrane.nx * membrane.ny, threads):
            nodes.unit[f, 6 * slot + 2 * motion, k] = 0.0
            nodes.unit[f, 6 * slot + 2 * motion + 1, k] = 0.0
        for a in range(lane, 2 * sticking.count[f], threads):
            n = sticking.held[f, a // 2]
            k = node_of(membrane, n)
            moved = float(0.0)
            if patch_of(fields, slot_of, f, finger, k) == slot + 1:
                x = node_at(membrane, fields.u, f, k // membrane.ny, k % membrane.ny)
                moved = rigid(x, middle, motion, a % 2)
            start_from(sticking, f, 2 * n + a % 2, moved)
        find_loads(sticking, f, lane, threads, _CLOSE)
        total = wp.vec3(0.0, 0.0, 0.0)
        for a in range(lane, 2 * sticking.count[f], threads):
            n = sticking.held[f, a // 2]
            k = node_of(membrane, n)
            nodes.unit[f, 6 * slot + 2 * motion + a % 2, k] = sticking.loads[f, 2 * n + a % 2]
            if patch_of(fields, slot_of, f, finger, k) == slot + 1:
                x = node_at(membrane, fields.u, f, k // membrane.ny, k % membrane.ny)
                load = sticking.loads[f, 2 * n + a % 2]
                for other in range(3):
                    total[other] += load * rigid(x, middle, other, a % 2)
        for other in range(3):
            found[motion, other] = sum_of(total[other])
        synchronize()
    return 0.5 * (found + wp.transpose(found))


@wp.func
def about_center(grip: wp.mat33, by: wp.vec3) -> wp.mat33:
    """Return a stiffness by `grip_of` about a center that has moved by `by`, m, on the body."""
    # a rotation about the new center is one about the old center with a translation
    T = wp.mat33(1.0, 0.0, by[1], 0.0, 1.0, -by[0], 0.0, 0.0, 1.0)
    return wp.transpose(T) @ grip @ T
