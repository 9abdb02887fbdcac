"""Forces, friction and sticking of the bodies on one membrane, as Warp functions.

The rules of kernels/qs_follow.c: a contact patch moves with its body as one rigid set, the
membrane holds it by its in-plane stiffness (X7 of docs/theory/quasistatic_membrane.md). Coulomb's
limit: node_friction.py. SI units, frame S.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.borders import force_on
from mjtactile.warp.device.edges import contact_area
from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid, node_at
from mjtactile.warp.device.obstacles import Geom

wp.set_module_options({"enable_backward": False})

MIN_FORCE = wp.constant(1.0e-4)
"""Force below which nothing sticks, N."""
_TILT = wp.constant(0.25)  # tilt stiffness over stiffness times radius^2


@wp.struct
class Patch:
    """Contact of one body on one membrane, and the memory of its friction.

    `force` and `torque` act on the membrane about the origin of S. `area` m^2 is that of X5.
    `grip` is the stiffness against motion about `middle`, `along` the motion over the membrane in
    the last step, m, m, rad.
    `shift` is the in-plane motion, m, of the contact nodes since the last solution, which is no
    motion of the body over the membrane. `moved` and `turned` are the motion of the body in the
    last step, `R` and `p` its pose.
    """

    touches: int
    slides: int
    normal: float
    area: float
    radius: float
    slid: float
    middle: wp.vec3
    force: wp.vec3
    torque: wp.vec3
    along: wp.vec3
    grip: wp.mat33
    R: wp.mat33
    p: wp.vec3
    moved: wp.vec3
    turned: wp.vec3
    shift: wp.vec2


@wp.func
def _sum(value: float) -> float:
    return wp.tile_extract(wp.tile_sum(wp.tile(value)), 0)


@wp.func
def sum_contact(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    slot_of: wp.array2d(dtype=int),
    before: wp.array3d(dtype=float),
    f: int,
    finger: int,
    slot: int,
    lane: int,
    threads: int,
    tension: float,
    has_thin: bool,
) -> Patch:
    """Sum the nodes in contact with the body of `slot`. `tension` N/m is the membrane's mean.

    `before` (F, 3, N): last in-plane displacements of the nodes, and 1 where they touched.
    """
    patch = Patch()
    q_sum = float(0.0)
    fx = float(0.0)
    fy = float(0.0)
    sx = float(0.0)
    sy = float(0.0)
    sz = float(0.0)
    tx = float(0.0)
    ty = float(0.0)
    tz = float(0.0)
    area = float(0.0)
    kept = float(0.0)
    shift_x = float(0.0)
    shift_y = float(0.0)
    for k in range(lane, membrane.nx * membrane.ny, threads):
        q = force_on(fields, slot_of, f, finger, slot, k)
        if q > 0.0:
            i = k // membrane.ny
            x = node_at(membrane, fields.u, f, i, k - i * membrane.ny)
            push = wp.vec3(q * fields.slope_x[f, k], q * fields.slope_y[f, k], -q)
            torque_k = wp.cross(x, push)
            q_sum += q
            own_area = contact_area(membrane, geoms, pool, fields, f, k, tension, has_thin)
            area += own_area * q / fields.force[f, k]
            fx += push[0]
            fy += push[1]
            sx += q * x[0]
            sy += q * x[1]
            sz += q * x[2]
            tx += torque_k[0]
            ty += torque_k[1]
            tz += torque_k[2]
            if before[f, 2, k] > 0.0:
                kept += q
                shift_x += q * (fields.u[f, 0, k] - before[f, 0, k])
                shift_y += q * (fields.u[f, 1, k] - before[f, 1, k])
    total = _sum(q_sum)
    over = 1.0 / wp.max(total, 1.0e-9)
    center = wp.vec3(_sum(sx) * over, _sum(sy) * over, _sum(sz) * over)
    patch.normal = total
    patch.middle = center
    patch.force = wp.vec3(_sum(fx), _sum(fy), -total)
    patch.torque = wp.vec3(_sum(tx), _sum(ty), _sum(tz))
    patch.area = _sum(area)
    over_kept = 1.0 / wp.max(_sum(kept), 1.0e-9)
    sum_of_distances = float(0.0)
    for k in range(lane, membrane.nx * membrane.ny, threads):
        q = force_on(fields, slot_of, f, finger, slot, k)
        if q > 0.0:
            i = k // membrane.ny
            x = node_at(membrane, fields.u, f, i, k - i * membrane.ny)
            sum_of_distances += q * wp.length(wp.vec2(x[0] - center[0], x[1] - center[1]))
    patch.radius = _sum(sum_of_distances) * over
    patch.shift = wp.vec2(_sum(shift_x) * over_kept, _sum(shift_y) * over_kept)
    return patch


@wp.func
def remember_nodes(
    membrane: MembraneGrid,
    fields: Fields,
    before: wp.array3d(dtype=float),
    f: int,
    lane: int,
    threads: int,
) -> None:
    """Store in-plane displacements and contact of all nodes for the next step."""
    for k in range(lane, membrane.nx * membrane.ny, threads):
        before[f, 0, k] = fields.u[f, 0, k]
        before[f, 1, k] = fields.u[f, 1, k]
        touched = float(0.0)
        if fields.force[f, k] > 0.0:
            touched = 1.0
        before[f, 2, k] = touched


@wp.func
def move(grip: wp.mat33, last: Patch, now: Patch, R: wp.mat33, p: wp.vec3) -> Patch:
    """Return `now` with the motion since `last` of its body, which is at the pose `R`, `p`.

    `grip` is the stiffness of the patch.
    """
    found = now
    found.R = R
    found.p = p
    found.touches = int(0)
    found.slides = int(0)
    found.along = wp.vec3(0.0, 0.0, 0.0)
    if now.normal > MIN_FORCE:
        found.touches = 1
        found.grip = grip
        found.slid = float(0.0)
        if last.touches != 0:
            rotation = R @ wp.transpose(last.R)
            was = wp.transpose(rotation) @ (last.middle - p)
            step = last.middle - was - last.p
            found.moved = p - last.p
            found.turned = 0.5 * wp.vec3(
                rotation[2, 1] - rotation[1, 2],
                rotation[0, 2] - rotation[2, 0],
                rotation[1, 0] - rotation[0, 1],
            )
            found.along = wp.vec3(step[0] - now.shift[0], step[1] - now.shift[1], found.turned[2])
            found.slid = last.slid
    else:
        found.force = wp.vec3(0.0, 0.0, 0.0)
        found.torque = wp.vec3(0.0, 0.0, 0.0)
        found.normal = 0.0
        found.area = 0.0
    return found


@wp.func
def normal_stiffness(
    tension: float, gas_stiffness: float, bulge: float, half: float, spacing: float, area: float
) -> float:
    """Return the stiffness against indentation, N/m: tension about a disc, and displaced gas."""
    radius = wp.sqrt(wp.max(area, spacing * spacing) / wp.static(3.14159265))
    wide = wp.log(wp.max(half / radius, 1.2))
    lifted = wp.static(3.14159265) * (half * half - radius * radius) / (2.0 * wide)
    gas = float(0.0)
    if gas_stiffness > 0.0:
        gas = 1.0 / (1.0 / gas_stiffness + bulge)
    return wp.static(2.0 * 3.14159265) * tension / wide + gas * lifted * lifted


@wp.func
def patch_stiffness(patch: Patch, normal: float, spacing: float) -> wp.spatial_vector:
    """Return the stiffness of a contact along and about the axes of S. `normal` N/m is along z."""
    arm = wp.max(patch.radius, 0.25 * spacing)
    tilt = _TILT * normal * arm * arm
    found = wp.spatial_vector(0.0, 0.0, normal, tilt, tilt, tilt)
    if patch.slides == 0:
        diagonal = wp.get_diag(patch.grip)
        found = wp.spatial_vector(diagonal[0], diagonal[1], normal, tilt, tilt, diagonal[2])
    return found


@wp.func
def held_motion(
    patch: Patch, stiffness: wp.spatial_vector, R_WS: wp.mat33, R_SB: wp.mat33, p_SB: wp.vec3
) -> wp.spatial_matrix:
    """Return the stiffness (6, 6) of a contact in the degrees of freedom of a body's free joint.

    Translations are in the world's frame, rotations in the body's.
    """
    along = wp.vec3(stiffness[0], stiffness[1], stiffness[2])
    about = wp.vec3(stiffness[3], stiffness[4], stiffness[5])
    r = patch.middle - p_SB
    K = wp.spatial_matrix()
    for a in range(6):
        va = _column(a, R_WS, R_SB, r)
        wa = _rotation(a, R_SB)
        for b in range(6):
            vb = _column(b, R_WS, R_SB, r)
            wb = _rotation(b, R_SB)
            K[a, b] = wp.dot(va, wp.cw_mul(along, vb)) + wp.dot(wa, wp.cw_mul(about, wb))
    return K


@wp.func
def _column(a: int, R_WS: wp.mat33, R_SB: wp.mat33, r: wp.vec3) -> wp.vec3:
    """Return the velocity in S of the contact's center by degree of freedom `a`."""
    found = wp.vec3(0.0, 0.0, 0.0)
    if a < 3:
        found = wp.vec3(R_WS[a, 0], R_WS[a, 1], R_WS[a, 2])
    else:
        found = wp.cross(_rotation(a, R_SB), r)
    return found


@wp.func
def _rotation(a: int, R_SB: wp.mat33) -> wp.vec3:
    found = wp.vec3(0.0, 0.0, 0.0)
    if a >= 3:
        found = wp.vec3(R_SB[0, a - 3], R_SB[1, a - 3], R_SB[2, a - 3])
    return found
