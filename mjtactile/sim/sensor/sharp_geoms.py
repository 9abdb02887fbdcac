"""Geoms that are small or sharp relative to a sensor's mesh. Contact spheres follow their shape."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.sim.sensor import feature_size, ray_intersection
from mjtactile.sim.sensor.mesh import MembraneMesh

KINDS = tuple(
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_BOX,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_MESH,
    )
)
"""Geoms that have edges."""
_MAX_FACES = 4000  # maximum number of hull faces of a thin geom
_CORE_SPACING = 0.15  # spacing of interior points of a thin geom, in cells


class SharpGeoms(NamedTuple):
    """Geoms whose shape the contact spheres follow.

    `shapes` are their entry functions of lines, `round` the cylinders much wider than the mesh
    spacing, of which only the ends are sharp. `cores` are interior points (m, 3) m of geoms that
    fit between vertices.
    """

    shapes: dict[int, ray_intersection.Entry]
    round: set[int]
    cores: dict[int, Array]


def missed(model: mujoco.MjModel, carrier: int, mesh: MembraneMesh) -> tuple[float, str]:
    """Return radius, m, and name of the thinnest geom that could slip between vertices.

    Its shape is not available here (a mesh of too many faces). Infinite if there is none.
    """
    found = []
    for geom in map(int, feature_size.touching_geoms(model, carrier)):
        if (
            _is_thin(model, geom, mesh)
            and ray_intersection.entry_of(model, geom, _MAX_FACES) is None
        ):
            found.append(
                (feature_size.feature_radius(model, geom), feature_size.name_of(model, geom))
            )
    return min(found, default=(np.inf, ""))


def sharp_geoms(model: mujoco.MjModel, carrier: int, mesh: MembraneMesh, cell: float) -> SharpGeoms:
    """Return the geoms that are small or sharp for the mesh of body `carrier`, of cells of `cell`
    m."""
    found = SharpGeoms({}, set(), {})
    for geom in map(int, feature_size.touching_geoms(model, carrier)):
        if not _is_sharp(model, geom, mesh):
            continue
        is_thin = _is_thin(model, geom, mesh)
        entry = ray_intersection.entry_of(model, geom, _MAX_FACES if is_thin else None)
        if entry is None:
            continue
        found.shapes[geom] = entry
        if is_thin:
            found.cores[geom] = feature_size.core(model, geom, _CORE_SPACING * cell)
        is_cylinder = int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_CYLINDER)
        if is_cylinder and model.geom_size[geom, 0] >= feature_size.RESOLVED * mesh.spacing:
            found.round.add(geom)
    return found


def _is_thin(model: mujoco.MjModel, geom: int, mesh: MembraneMesh) -> bool:
    """Return True if the geom fits between vertices."""
    return feature_size.feature_radius(model, geom) < feature_size.SLIPS * mesh.spacing


def _is_sharp(model: mujoco.MjModel, geom: int, mesh: MembraneMesh) -> bool:
    """Return True if the geom has edges or is small."""
    is_small = feature_size.feature_radius(model, geom) < feature_size.RESOLVED * mesh.spacing
    return is_small or int(model.geom_type[geom]) in KINDS
