"""Touch of a curved object by a mesh of facets: how far from the object its vertices have to stay.

Where the vertices lie on a convex object, the facets between them cut into it, and the membrane is indented too little:
the force of a sphere of 8 mm is 5-8 % low at 13 x 11 vertices. A membrane whose facets touch the object on the average
stands off by their mean sagitta, (hx^2 + hy^2)/24 times the sum of the curvatures; a quarter of it, measured, gives the
force of a fine mesh (tests/physics/test_contact.py). The stand-off falls with the square of the spacing, so that it leaves
what a mesh converges to; flat faces get none (docs/equations.md, C2).
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor.features import END
from mjtactile.sim.sensor.mesh import MembraneMesh

_SPHERE, _CAPSULE, _CYLINDER, _ELLIPSOID = (int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in (
    "SPHERE", "CAPSULE", "CYLINDER", "ELLIPSOID"))
SHARE = 0.25  # of the facets' mean sagitta
_EVERY, _SETTLE = 0.01, 0.02  # s: how often to look at the contacts, and the time constant with which the stand-off follows


class StandOff:
    """Contact margins of one sensor's vertex spheres, by the curvature of what each of them touches.

    Vertices that touch nothing are ready for what the others touch; without any contact the stand-off goes to zero.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, vertex_geom_ids: np.ndarray, mesh: MembraneMesh):
        self._model, self._data = model, data
        self._first, self._last = int(vertex_geom_ids[0]), int(vertex_geom_ids[-1])  # one block, in the mesh's order
        self.margins: Array = np.zeros(len(vertex_geom_ids))
        """Distances (k,) m of the vertices' spheres from what they touch."""
        self._sagitta = SHARE * mesh.areas[mesh.interior] / 12  # m^2, per curvature kx + ky: hx^2 + hy^2 is about 2 hx hy
        self._time = float(data.time)

    def update(self) -> None:
        """Follow the contacts of the last step; call every step, it works every 10 ms."""
        time = float(self._data.time)
        elapsed = time - self._time
        if 0 <= elapsed < _EVERY:
            return
        self._time = time
        goal = self._sagitta * self._curvatures()
        self.margins += (goal - self.margins) * min(abs(elapsed) / _SETTLE, 1.0)

    def _curvatures(self) -> Array:
        """Curvature kx + ky, 1/m, of what each vertex touches, or the others' mean where it touches nothing."""
        contact = self._data.contact
        pairs = contact.geom
        mine = (pairs >= self._first) & (pairs <= self._last)  # (ncon, 2)
        rows = np.flatnonzero(mine.any(axis=1))
        if not len(rows):
            return np.zeros(len(self.margins))
        second = mine[rows, 1]
        vertices = np.where(second, pairs[rows, 1], pairs[rows, 0]) - self._first
        others = np.where(second, pairs[rows, 0], pairs[rows, 1])
        axes = self._data.geom_xmat[others].reshape(-1, 3, 3)
        normals = np.einsum("kji,kj->ki", axes, contact.frame[rows, :3])
        found = np.where(others >= 0, curvatures(self._model, others, normals), 0.0)  # no geom: a flex
        result = np.full(len(self.margins), found.mean())
        result[vertices] = found
        return result


def curvatures(model: mujoco.MjModel, geoms: NDArray[np.int64], normals: Array) -> Array:
    """Sums of the principal curvatures (n,) 1/m of `geoms` (n,) where their surfaces have the unit `normals` (n, 3), each in
    its geom's frame. Zero for faces, and for meshes and height fields, whose curvature is not known."""
    kinds, sizes = model.geom_type[geoms], model.geom_size[geoms]
    axial = np.abs(normals[:, 2])
    turns = (2 * (kinds == _SPHERE) + np.where(axial < 0.1, 1, 2) * (kinds == _CAPSULE)
             + (axial < END) * (kinds == _CYLINDER))  # how many of the two curvatures are one over the first size
    result = turns / np.where(turns > 0, sizes[:, 0], 1.0)
    rows = np.flatnonzero(kinds == _ELLIPSOID)
    if len(rows):
        result[rows] = _of_ellipsoids(sizes[rows], normals[rows])
    return result


def _of_ellipsoids(sizes: Array, normals: Array) -> Array:
    squares = sizes * sizes
    # gradient of half of sum (x/a)^2 where the normal is this one
    slope = normals / np.sqrt((squares * normals**2).sum(axis=1, keepdims=True))
    length2 = (slope * slope).sum(axis=1)
    return (length2 * (1 / squares).sum(axis=1) - (slope * slope / squares).sum(axis=1)) / length2**1.5
