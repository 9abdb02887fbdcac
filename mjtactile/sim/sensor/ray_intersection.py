"""Entry points of many lines into a geom: heights of obstacles over points of a membrane.

A geom is a polytope (box, hull of a mesh), an ellipsoid, a cylinder, or a capsule. MuJoCo's own
rays handle one point per call; tests compare with them.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from mjtactile.core.types import Array

MAX_FACES = 400
"""Maximum face count of a mesh's hull. More are smooth at the membrane's vertex spacing."""
MISSED = np.inf
_TINY = 1e-12
_BOX, _SPHERE, _ELLIPSOID, _CYLINDER, _CAPSULE, _MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("BOX", "SPHERE", "ELLIPSOID", "CYLINDER", "CAPSULE", "MESH")
)

Entry = Callable[[Array, Array], Array]
"""Function of points (n, 3) m and unit directions (n, 3), in the geom's frame: signed distances
(n,) m along the lines to their entry into the geom, `MISSED` without intersection."""


def entry_of(model: mujoco.MjModel, geom: int, maximum: int | None = None) -> Entry | None:
    """Return the entry function of a geom; None for a plane, a height field or too many faces."""
    kind = int(model.geom_type[geom])
    size = np.asarray(model.geom_size[geom], float).copy()
    if kind == _BOX:
        return _polytope(np.vstack([np.eye(3), -np.eye(3)]), np.tile(size, 2))
    if kind in (_SPHERE, _ELLIPSOID):
        return _ellipsoid(np.full(3, size[0]) if kind == _SPHERE else size)
    if kind == _CYLINDER:
        return _cylinder(size[0], size[1])
    if kind == _CAPSULE:
        return _capsule(size[0], size[1])
    if kind == _MESH and model.geom_dataid[geom] >= 0:
        return _hull(model, int(model.geom_dataid[geom]), MAX_FACES if maximum is None else maximum)
    return None


def _entry_distance(enters: Array, leaves: Array) -> Array:
    return np.where(enters < leaves, enters, MISSED)


def _polytope(normals: Array, offsets: Array) -> Entry:
    """Return the entry function of all points x with normals (m, 3) x <= offsets (m,) m."""

    def entry(points: Array, directions: Array) -> Array:
        along = directions @ normals.T
        room = offsets - points @ normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = room / along
        outside = ((np.abs(along) <= _TINY) & (room < 0)).any(axis=1)
        enters = np.where(along < -_TINY, at, -np.inf).max(axis=1)
        leaves = np.where(along > _TINY, at, np.inf).min(axis=1)
        return np.where(outside, MISSED, _entry_distance(enters, leaves))

    return entry


def _ellipsoid(size: Array) -> Entry:
    def entry(points: Array, directions: Array) -> Array:
        return _roots(points / size, directions / size)[0]

    return entry


def _roots(points: Array, directions: Array) -> tuple[Array, Array]:
    """Return entry and exit distances of lines through the unit sphere or circle, or +-`MISSED`."""
    a, b, c = (
        (p * q).sum(axis=1)
        for p, q in ((directions, directions), (points, directions), (points, points))
    )
    root = b * b - a * (c - 1)
    hit = (root > 0) & (a > _TINY)
    extent = np.sqrt(np.where(hit, root, 0.0))
    a = np.where(hit, a, 1.0)
    return np.where(hit, (-b - extent) / a, MISSED), np.where(hit, (-b + extent) / a, -MISSED)


def _cylinder(radius: float, half: float) -> Entry:
    def entry(points: Array, directions: Array) -> Array:
        plane = points[:, :2] / radius
        slope = directions[:, :2] / radius
        enters, leaves = _roots(plane, slope)
        # a ray along the axis is inside over its whole length, or nowhere
        axial = (slope * slope).sum(axis=1) <= _TINY
        inside = axial & ((plane * plane).sum(axis=1) < 1)
        enters = np.where(inside, -np.inf, enters)
        leaves = np.where(inside, np.inf, leaves)
        first, last = _slab(points[:, 2], directions[:, 2], half)
        return _entry_distance(np.maximum(enters, first), np.minimum(leaves, last))

    return entry


def _slab(heights: Array, slopes: Array, half: float) -> tuple[Array, Array]:
    """Return entry and exit distances of lines through the slab of +-`half` m."""
    level = np.abs(slopes) <= _TINY
    inside = np.abs(heights) < half
    slope = np.where(level, 1.0, slopes)
    center = -heights / slope
    extent = half / np.abs(slope)
    enters = np.where(inside, -np.inf, MISSED)
    leaves = np.where(inside, np.inf, -MISSED)
    return np.where(level, enters, center - extent), np.where(level, leaves, center + extent)


def _capsule(radius: float, half: float) -> Entry:
    side = _cylinder(radius, half)
    ball = _ellipsoid(np.full(3, radius))
    shift = np.array([0.0, 0.0, half])

    def entry(points: Array, directions: Array) -> Array:
        balls = np.minimum(ball(points - shift, directions), ball(points + shift, directions))
        return np.minimum(side(points, directions), balls)

    return entry


def _hull(model: mujoco.MjModel, mesh: int, maximum: int) -> Entry | None:
    from scipy.spatial import ConvexHull, QhullError

    first = int(model.mesh_vertadr[mesh])
    vertices = np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], float)
    try:
        planes = np.unique(ConvexHull(vertices).equations.round(6), axis=0)
    except QhullError:  # flat
        return None
    if len(planes) <= maximum:
        return _polytope(planes[:, :3], -planes[:, 3])
    return None
