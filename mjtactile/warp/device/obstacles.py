"""Lower sides of MuJoCo geoms along the membrane's z, as Warp functions.

The same closed forms as kernels/qs_obstacles.c: the first point of a vertical line inside the geom.
SI units, frame S. Single precision. See docs/theory/quasistatic_membrane.md.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, CONVEX = 0, 2, 3, 4, 5, 6, 7
"""Kinds of geoms, with MuJoCo's numbers (`mujoco.mjtGeom`)."""

SUPPORTED = (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, CONVEX)

MISS = wp.constant(1.0e6)  # height where there is no obstacle, m
_ON = wp.constant(1.0e5)  # heights below this are on an obstacle, m
_FLANK = wp.constant(2.0)  # slope beyond which a box or a cylinder counts as ended
_STEEPEST = wp.constant(4.0)  # maximum ratio of distances along z and along the normal
_LEVEL = wp.constant(1.0e-7)  # component of a normal along a line below which they are parallel


@wp.struct
class Geom:
    """One geom in frame S: kind, sizes as in MJCF, pose, and its planes in a pool (kind CONVEX)."""

    kind: int
    size: wp.vec3
    p: wp.vec3
    R: wp.mat33
    first: int
    count: int


@wp.func
def is_on(height: float) -> bool:
    return height < _ON


@wp.func
def _first_root(a: float, b: float, c: float) -> float:
    """Return the smaller root of a t^2 + 2 b t + c, or MISS."""
    inside = b * b - a * c
    found = float(MISS)
    if inside > 0.0 and a > 1.0e-12:
        found = (-b - wp.sqrt(inside)) / a
    return found


@wp.func
def _result(geom: Geom, t: float, n: wp.vec3, out: float, steepest: float) -> wp.vec3:
    """Return height and slopes for the hit at `t` with outward normal `n` (geom's frame)."""
    world = geom.R @ n
    found = wp.vec3(MISS, 0.0, 0.0)
    if t < _ON and world[2] < 0.0:
        sx = -world[0] / world[2]
        sy = -world[1] / world[2]
        square = sx * sx + sy * sy
        if square <= steepest * steepest:
            found = wp.vec3(t - out * wp.min(wp.sqrt(1.0 + square), _STEEPEST), sx, sy)
    return found


@wp.func
def _ball(from_: wp.vec3, along: wp.vec3, middle: wp.vec3, radius: float) -> float:
    offset = from_ - middle
    return _first_root(1.0, wp.dot(offset, along), wp.dot(offset, offset) - radius * radius)


@wp.func
def _side(from_: wp.vec3, along: wp.vec3, radius: float, half: float) -> float:
    """Intersect a line with the side of a cylinder about z, up to |z| <= half."""
    t = _first_root(
        along[0] * along[0] + along[1] * along[1],
        from_[0] * along[0] + from_[1] * along[1],
        from_[0] * from_[0] + from_[1] * from_[1] - radius * radius,
    )
    if t < _ON and wp.abs(from_[2] + t * along[2]) > half:
        t = MISS
    return t


@wp.func
def _capsule(geom: Geom, from_: wp.vec3, along: wp.vec3, half_thickness: float) -> wp.vec3:
    radius = geom.size[0] + half_thickness
    half = geom.size[1]
    t = _side(from_, along, radius, half)
    n = wp.vec3(from_[0] + t * along[0], from_[1] + t * along[1], 0.0)
    if t > _ON:
        for end in range(2):
            center = wp.vec3(0.0, 0.0, half * (2.0 * float(end) - 1.0))
            at = _ball(from_, along, center, radius)
            if at < t:
                t = at
                n = from_ + at * along - center
    return _result(geom, t, n, 0.0, MISS)


@wp.func
def _ellipsoid(geom: Geom, from_: wp.vec3, along: wp.vec3, half_thickness: float) -> wp.vec3:
    o = wp.cw_div(from_, geom.size)
    d = wp.cw_div(along, geom.size)
    t = _first_root(wp.dot(d, d), wp.dot(o, d), wp.dot(o, o) - 1.0)
    n = wp.cw_div(o + t * d, geom.size)
    return _result(geom, t, n, half_thickness, MISS)


@wp.func
def _cylinder(geom: Geom, from_: wp.vec3, along: wp.vec3, half_thickness: float) -> wp.vec3:
    radius = geom.size[0]
    t = _side(from_, along, radius, geom.size[1])
    n = wp.vec3(from_[0] + t * along[0], from_[1] + t * along[1], 0.0)
    if wp.abs(along[2]) > _LEVEL:
        for end in range(2):
            sign = 2.0 * float(end) - 1.0
            at = (sign * geom.size[1] - from_[2]) / along[2]
            x = from_[0] + at * along[0]
            y = from_[1] + at * along[1]
            if x * x + y * y <= radius * radius and at < t:
                t = at
                n = wp.vec3(0.0, 0.0, sign)
    return _result(geom, t, n, half_thickness, _FLANK)


@wp.func
def _box(geom: Geom, from_: wp.vec3, along: wp.vec3, half_thickness: float) -> wp.vec3:
    enter = float(-MISS)
    leave = float(MISS)
    n = wp.vec3(0.0, 0.0, -1.0)
    for k in range(3):
        if wp.abs(along[k]) > _LEVEL:
            near = (-geom.size[k] - from_[k]) / along[k]
            far = (geom.size[k] - from_[k]) / along[k]
            sign = float(-1.0)
            if near > far:
                near, far = far, near
                sign = 1.0
            if near > enter:
                enter = near
                n = wp.vec3(0.0, 0.0, 0.0)
                n[k] = sign
            leave = wp.min(leave, far)
        elif wp.abs(from_[k]) > geom.size[k]:
            leave = -MISS
    if enter >= leave:
        enter = MISS
    return _result(geom, enter, n, half_thickness, _FLANK)


@wp.func
def _convex(
    geom: Geom, from_: wp.vec3, along: wp.vec3, half_thickness: float, pool: wp.array(dtype=wp.vec4)
) -> wp.vec3:
    """Intersect a line with the half-spaces n x <= d of a hull."""
    enter = float(-MISS)
    leave = float(MISS)
    n = wp.vec3(0.0, 0.0, -1.0)
    for k in range(geom.count):
        row = pool[geom.first + k]
        normal = wp.vec3(row[0], row[1], row[2])
        towards = wp.dot(normal, along)
        left = row[3] - wp.dot(normal, from_)
        if wp.abs(towards) <= _LEVEL:
            if left < 0.0:
                leave = -MISS
        elif towards < 0.0:
            if left / towards > enter:
                enter = left / towards
                n = normal
        else:
            leave = wp.min(leave, left / towards)
    if enter >= leave:
        enter = MISS
    return _result(geom, enter, n, half_thickness, MISS)


@wp.func
def obstacle_height(
    geom: Geom, pool: wp.array(dtype=wp.vec4), half_thickness: float, x: float, y: float
) -> wp.vec3:
    """Return the maximum height of the membrane's mid-surface below a geom, and its slopes.

    The height is MISS where the geom does not cover (x, y).
    """
    Rt = wp.transpose(geom.R)
    from_ = Rt @ wp.vec3(x - geom.p[0], y - geom.p[1], -geom.p[2])
    along = Rt @ wp.vec3(0.0, 0.0, 1.0)
    found = wp.vec3(MISS, 0.0, 0.0)
    if geom.kind == SPHERE:
        t = _ball(from_, along, wp.vec3(0.0, 0.0, 0.0), geom.size[0] + half_thickness)
        found = _result(geom, t, from_ + t * along, 0.0, MISS)
    elif geom.kind == CAPSULE:
        found = _capsule(geom, from_, along, half_thickness)
    elif geom.kind == ELLIPSOID:
        found = _ellipsoid(geom, from_, along, half_thickness)
    elif geom.kind == CYLINDER:
        found = _cylinder(geom, from_, along, half_thickness)
    elif geom.kind == BOX:
        found = _box(geom, from_, along, half_thickness)
    elif geom.kind == CONVEX:
        found = _convex(geom, from_, along, half_thickness, pool)
    elif geom.kind == PLANE:
        # solid on the far side, for either direction of its normal
        n = wp.vec3(0.0, 0.0, 1.0)
        if along[2] > 0.0:
            n = wp.vec3(0.0, 0.0, -1.0)
        t = float(MISS)
        if wp.abs(along[2]) > _LEVEL:
            t = -from_[2] / along[2]
        found = _result(geom, t, n, half_thickness, MISS)
    return found
