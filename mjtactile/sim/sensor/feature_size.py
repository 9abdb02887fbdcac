"""Feature size of geoms relative to a membrane's mesh, and points inside of them.

Feature size determines contact model and accuracy. Small contact spheres on the vertices suit geoms
larger than the mesh spacing. Their force error is an eighth of that of triangles, which protrude
beyond a round object. Spheres also settle on flat faces. A pin, however, slips between spheres.
Triangles detect every pin. Its force then depends on the mesh, because the membrane can bend only
at the vertices.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor.mesh import MembraneMesh

CONTACT_MODELS = ("vertices", "elements", "both")
CONVEX = 0.98
"""Volume over that of the convex hull from which a mesh counts as convex."""
END = 0.7
"""Cosine of a normal to a cylinder's axis above which its end face touches."""
SLIPS = 1.0
"""Radius in vertex spacings below which a feature can slip between unshifted vertices."""
RESOLVED = 2.0
"""Radius in vertex spacings from which a feature's force is within 5 %."""


def touching_geoms(model: mujoco.MjModel, carrier: int = 0) -> NDArray[np.int64]:
    """Return the geoms (n,) with a contype that are not fixed to body `carrier` (0: the world)."""
    welds = weld_bodies(model)
    others = welds[model.geom_bodyid] != welds[carrier]
    return np.flatnonzero(others & (model.geom_contype != 0))


def weld_bodies(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the MuJoCo body to which each body is fixed (nbody,)."""
    return np.array([_weld(model, body) for body in range(model.nbody)])


def _weld(model: mujoco.MjModel, body: int) -> int:
    """Return the MuJoCo body to which `body` is fixed, or its mocap body."""
    if model.body_weldid[body]:
        return int(model.body_weldid[body])
    while body and model.body_mocapid[body] < 0:
        body = int(model.body_parentid[body])
    return body


def feature_radius(model: mujoco.MjModel, geom: int) -> float:
    """Return the smallest contact radius of a geom, m: half the smallest side of a box or mesh."""
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
        return float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return float(size[:2].min())
    if kind in (mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_BOX):
        return float(size.min())
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return float(model.geom_aabb[geom, 3:].min())
    return np.inf


def name_of(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or its id and body."""
    body = model.body(int(model.geom_bodyid[geom])).name
    return model.geom(geom).name or f"geom {geom}{f' of {body}' if body else ''}"


def box_distances(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, points: Array
) -> NDArray[np.float64]:
    """Return the distances (n,), m, of `points` (n, 3), m, in W, from the bounding box of a geom; 0
    inside."""
    box = model.geom_aabb[geom]
    local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3) - box[:3]
    return np.linalg.norm(np.maximum(np.abs(local) - box[3:], 0.0), axis=1)


def smallest_feature(model: mujoco.MjModel) -> tuple[float, str]:
    """Return radius, m, and name of the smallest geom that can touch; infinite if there is none."""
    found = [(feature_radius(model, int(g)), name_of(model, int(g))) for g in touching_geoms(model)]
    return min(found, default=(np.inf, ""))


def filled_fraction(vertices: Array, faces: NDArray[np.int64]) -> float:
    """Return the volume of a closed triangle surface over that of its convex hull."""
    from scipy.spatial import ConvexHull, QhullError

    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
    try:
        return min(abs(volume) / ConvexHull(vertices).volume, 1.0)
    except (QhullError, ZeroDivisionError):
        return 1.0


def hull_flag(model: mujoco.MjModel, geom: int) -> str | None:
    """Return a flag if a touching geom is a non-convex mesh, whose hull makes the contact."""
    mesh_id = int(model.geom_dataid[geom])
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH or mesh_id < 0:
        return None
    mesh = model.mesh(mesh_id)
    vertices = int(mesh.vertadr[0])
    faces = int(mesh.faceadr[0])
    fraction = filled_fraction(
        np.asarray(model.mesh_vert[vertices : vertices + model.mesh_vertnum[mesh_id]], float),
        model.mesh_face[faces : faces + model.mesh_facenum[mesh_id]].astype(np.int64),
    )
    if fraction >= CONVEX:
        return None
    return (
        f"mesh {mesh.name!r} fills {fraction:.0%} of its convex hull, and MuJoCo uses the hull "
        "for contact: split it into convex geoms, or use `press`, which splits it after pip "
        "install 'mjtactile[meshes]'"
    )


def resolution_flag(
    model: mujoco.MjModel, geom: int, radius: float, mesh: MembraneMesh, contact: str
) -> str | None:
    """Return a flag if a geom of `feature_radius` m is too small for the mesh in this contact
    model."""
    if radius >= RESOLVED * mesh.spacing:
        return None
    name = name_of(model, geom)
    factor = RESOLVED * mesh.spacing / radius
    finer = tuple(int(np.ceil((n - 1) * factor)) + 1 for n in (mesh.nx, mesh.ny))
    remedy = f"use mesh {finer}, which resolves it"
    if max(finer) > 61:
        remedy = "no affordable mesh resolves it; use position and time, not force"
    return (
        f"{name!r} (radius {radius * 1e3:.2g} mm) is finer than the mesh "
        f"({mesh.spacing * 1e3:.2g} mm between vertices): "
        f"its force may be off by {_error(radius / mesh.spacing, contact):.0%}; {remedy}"
    )


def edge_half_width(model: mujoco.MjModel, geom: int, axial: float) -> float:
    """Return the half width, m, of a geom's contact face with sharp edges; infinite without one.

    `axial` is the cosine between the contact's normal and the geom's z.
    """
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return float(model.geom_size[geom, 0]) if axial > END else np.inf
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return float(np.sort(model.geom_size[geom])[1])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return float(np.sort(model.geom_aabb[geom, 3:])[1])
    return np.inf


def edge_flag(half_width: float, mesh: MembraneMesh) -> str | None:
    """Return a flag with the force error due to an edge's position between the vertices."""
    if half_width > np.abs(mesh.p_SV).max():
        return None
    # Compared with an independent solver, squares of 6 and 12 mm (ratios 0.75 and 0.37) give 0.3 to
    # 1.4 and 0.5 to 1.2 times the force, depending on position and on the touching part of the
    # membrane.
    fraction = min(1.4 * mesh.spacing / half_width, 0.7)
    return (
        f"a sharp edge is in contact, {half_width * 1e3:.2g} mm from the center of its face, "
        f"and the mesh has {mesh.spacing * 1e3:.2g} mm between vertices: the force may be off "
        f"by {fraction:.0%} ({1 - fraction:.1f} to {1 + min(fraction, 0.4):.1f} times); a finer "
        "mesh reduces this in proportion"
    )


# bench wide-faces: 13 x 11 vertices differ from 25 x 21 by up to 10 %
_RIM_ERROR = 0.1
_FINE = 20  # vertices along the shorter side


def rim_flag(distance: float, width: float, mesh: MembraneMesh) -> str | None:
    """Return a flag with the force error due to the mesh next to the frame.

    `distance`, m, is that of a flat contact from the frame. `width`, m, is the frame's shorter
    side. Between the last vertices and the frame, the membrane is one straight segment.
    """
    vertices = min(mesh.nx, mesh.ny)
    if vertices >= _FINE or distance > 1.5 * width / (vertices - 1):
        return None
    return (
        "a face reaches the last vertices in front of the frame: with a mesh of "
        f"{mesh.nx} x {mesh.ny} the force may be off by {_RIM_ERROR:.0%}, its estimate without a "
        f"pressure sensor by more; use {2 * mesh.nx - 1} x {2 * mesh.ny - 1} vertices"
    )


def _error(ratio: float, contact: str) -> float:
    """Return the relative force error of a round or thin geom of `ratio` vertex spacings."""
    of_triangles = [0.8, 0.5, 0.3, 0.05]
    of_vertices = [0.3, 0.3, 0.3, 0.05]
    errors = of_vertices if contact == "vertices" else of_triangles
    return float(np.interp(ratio, [0.25, 0.5, 1.0, 2.0], errors))


_MAX_POINTS = 300  # of a mesh


def core(model: mujoco.MjModel, geom: int, pitch: float = np.inf) -> Array:
    """Return points (n, 3) m inside a geom, at most about `pitch` m from each other, in its
    frame."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    size = np.asarray(model.geom_size[geom], float)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return _grid(np.array([0.0, 0.0, size[1]]), pitch)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _cylinder(float(size[0]), float(size[1]), pitch)
    if kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        points = _grid(size - size.min(), pitch)
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            return points
        return points[((points / size) ** 2).sum(axis=1) < 1]
    if kind == mujoco.mjtGeom.mjGEOM_MESH and model.geom_dataid[geom] >= 0:
        return _mesh(model, geom)
    return np.zeros((0, 3))


def _grid(half: Array, pitch: float) -> Array:
    """Return grid points (n, 3) m of a box of half-extents `half` m, nine or more along a side."""
    counts = np.where(half > 0, np.maximum(np.ceil(2 * half / pitch), 8), 0).astype(int) + 1
    axes = [
        np.linspace(-h, h, n) if n > 1 else np.zeros(1) for h, n in zip(half, counts, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _cylinder(radius: float, half: float, pitch: float) -> Array:
    minimum = min(radius, half)
    axis = _grid(np.array([0.0, 0.0, half - minimum]), pitch)
    if radius <= half:
        return axis
    flat = _grid(np.array([radius - minimum, radius - minimum, 0.0]), pitch)
    return flat[np.hypot(flat[:, 0], flat[:, 1]) <= radius - minimum]


def _mesh(model: mujoco.MjModel, geom: int) -> Array:
    """Return vertices and edge points of a mesh, moved towards its center by its feature radius."""
    mesh = int(model.geom_dataid[geom])
    vertices = slice(int(model.mesh_vertadr[mesh]), None)
    corners = np.asarray(model.mesh_vert[vertices][: model.mesh_vertnum[mesh]], float)
    first = int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[first : first + model.mesh_facenum[mesh]]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]]), axis=1), axis=0)
    fractions = np.linspace(0.125, 0.875, 7)[:, None, None]
    between = (1 - fractions) * corners[edges[:, 0]] + fractions * corners[edges[:, 1]]
    points = np.concatenate([corners, between.reshape(-1, 3)])
    points = points[:: max(1, len(points) // _MAX_POINTS)]
    away = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)
    thin = feature_radius(model, geom)
    return points * np.maximum(1 - thin / away, 0.0)
