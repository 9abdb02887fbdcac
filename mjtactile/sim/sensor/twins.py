"""Thin boxes and capsules as meshes, which MuJoCo collides with triangles by another routine.

Its routines for a box or a capsule against a triangle look at corners, ends and the triangle's
vertices: an edge or a side that crosses a triangle between them is missed. The general routine for
convex shapes, which meshes and cylinders take, finds it.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.sim.sensor import features
from mjtactile.sim.sensor.mesh import MembraneMesh

_SIDES = 24  # of a capsule's cross-section: its radius is right within 0.5 %
_RINGS = 6  # of each of its ends
_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)


def replace_thin(spec: mujoco.MjSpec, mesh: MembraneMesh, contact: str) -> None:
    """Make meshes of the thin boxes and capsules of `spec` if triangles are to touch them.

    Args:
        spec: The scene; geoms keep name, place, mass and all that is said of contact.
        mesh: The membrane's.
        contact: Its contact model, or "auto".
    """
    limit = features.RESOLVED * mesh.spacing
    if contact == "vertices" or not any(_may_be_thin(geom, limit) for geom in spec.geoms):
        return
    try:
        model = spec.copy().compile()
    except ValueError:  # whoever compiles the scene is told
        return
    solid = np.flatnonzero(model.geom_contype)
    smallest = min((features.feature_radius(model, int(geom)) for geom in solid), default=np.inf)
    by_size = contact in (features.AUTO, features.AUTO_OF_MOVERS)
    if by_size and features.contact_model(smallest, mesh) == "vertices":
        return
    geoms = list(spec.geoms)
    for number in _thin_primitives(model, solid, limit):
        _make_mesh(spec, geoms[number], model, number)


def refuse_thin(model: mujoco.MjModel, carrier: int, mesh: MembraneMesh) -> None:
    """Raise InputError for a thin box or capsule that the triangles on body `carrier` would miss: a
    scene that got it after `attach`."""
    felt = features.touching_geoms(model, carrier)
    for geom in _thin_primitives(model, felt, features.RESOLVED * mesh.spacing):
        raise InputError(
            f"{features.name_of(model, geom)!r} is too thin a box or capsule for triangles to "
            "meet: add it to the scene before attach, which makes a mesh of it, or give it as "
            "a mesh or cylinder",
            source="bind",
            field="contact",
        )


def _may_be_thin(geom: mujoco.MjsGeom, limit: float) -> bool:
    """Whether a geom that is not compiled yet is perhaps a thin box or capsule."""
    if int(geom.type) not in (_BOX, _CAPSULE) or not geom.contype:
        return False
    known = [size for size in geom.size if size > 0]  # the others are in `fromto`, or of a mesh
    return bool(geom.meshname) or min(known, default=0.0) < limit


def _thin_primitives(model: mujoco.MjModel, geoms: NDArray[np.int64], limit: float) -> list[int]:
    return [
        int(geom)
        for geom in geoms
        if int(model.geom_type[geom]) in (_BOX, _CAPSULE)
        and features.feature_radius(model, int(geom)) < limit
    ]


def _make_mesh(
    spec: mujoco.MjSpec, geom: mujoco.MjsGeom, model: mujoco.MjModel, number: int
) -> None:
    """Turn the geom into the mesh of what it is as geom `number` of the compiled `model`."""
    size = model.geom_size[number]
    name = f"mjtactile/thin{len(spec.meshes)}"
    if int(geom.type) == _BOX:
        vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        volume = 8 * float(size.prod())
    else:
        vertices = _capsule_vertices(float(size[0]), float(size[1]))
        volume = np.pi * size[0] ** 2 * (2 * size[1] + 4 / 3 * size[0])
    asset = spec.add_mesh(name=name)
    asset.uservert = vertices.ravel().tolist()
    asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    if np.isnan(geom.mass):
        geom.mass = geom.density * volume
    geom.pos = model.geom_pos[number]
    geom.quat = model.geom_quat[number]
    geom.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    geom.fromto = [np.nan] * 6
    geom.type = mujoco.mjtGeom.mjGEOM_MESH
    geom.meshname = name


def _capsule_vertices(radius: float, half: float) -> Array:
    """Points (n, 3) m on a capsule about z: rings on its two ends, and their tips."""
    angles = np.arange(_SIDES) * 2 * np.pi / _SIDES
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = [np.array([[0.0, 0.0, half + radius]])]
    for slope in np.linspace(0, np.pi / 2, _RINGS, endpoint=False):
        heights = np.full((_SIDES, 1), half + radius * np.sin(slope))
        points.append(np.hstack([radius * np.cos(slope) * circle, heights]))
    upper = np.concatenate(points)
    return np.concatenate([upper, upper * (1, 1, -1)])
