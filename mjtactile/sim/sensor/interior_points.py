"""Points inside of geoms, about as deep below the surface as the geom is thin."""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.sim.sensor import feature_size

_MAX_POINTS = 300  # of a mesh


def core(model: mujoco.MjModel, geom: int, apart: float = np.inf) -> Array:
    """Return points (n, 3) m inside a geom, at most about `apart` m from each other, in its
    frame."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    size = np.asarray(model.geom_size[geom], float)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return _grid(np.array([0.0, 0.0, size[1]]), apart)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _cylinder(float(size[0]), float(size[1]), apart)
    if kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        points = _grid(size - size.min(), apart)
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            return points
        return points[((points / size) ** 2).sum(axis=1) < 1]
    if kind == mujoco.mjtGeom.mjGEOM_MESH and model.geom_dataid[geom] >= 0:
        return _mesh(model, geom)
    return np.zeros((0, 3))


def _grid(half: Array, apart: float) -> Array:
    """Return grid points (n, 3) m of a box of half-extents `half` m, nine or more along a side."""
    counts = np.where(half > 0, np.maximum(np.ceil(2 * half / apart), 8), 0).astype(int) + 1
    axes = [
        np.linspace(-h, h, n) if n > 1 else np.zeros(1) for h, n in zip(half, counts, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _cylinder(radius: float, half: float, apart: float) -> Array:
    minimum = min(radius, half)
    axis = _grid(np.array([0.0, 0.0, half - minimum]), apart)
    if radius <= half:
        return axis
    flat = _grid(np.array([radius - minimum, radius - minimum, 0.0]), apart)
    return flat[np.hypot(flat[:, 0], flat[:, 1]) <= radius - minimum]


def _mesh(model: mujoco.MjModel, geom: int) -> Array:
    """Return vertices and edge points of a mesh, moved towards its center by its feature radius."""
    mesh = int(model.geom_dataid[geom])
    vertices = slice(int(model.mesh_vertadr[mesh]), None)
    corners = np.asarray(model.mesh_vert[vertices][: model.mesh_vertnum[mesh]], float)
    first = int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[first : first + model.mesh_facenum[mesh]]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]]), axis=1), axis=0)
    shares = np.linspace(0.125, 0.875, 7)[:, None, None]
    between = (1 - shares) * corners[edges[:, 0]] + shares * corners[edges[:, 1]]
    points = np.concatenate([corners, between.reshape(-1, 3)])
    points = points[:: max(1, len(points) // _MAX_POINTS)]
    away = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)
    thin = feature_size.feature_radius(model, geom)
    return points * np.maximum(1 - thin / away, 0.0)
