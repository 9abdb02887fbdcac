"""Touch of a curved object by a mesh of facets: how far from the object its vertices have to stay.

Where the vertices lie on a convex object, the facets between them cut into it, and the membrane is indented too little:
the force of a sphere of 8 mm is 5-8 % low at 13 x 11 vertices. A membrane whose facets touch the object on the average
stands off by their mean sagitta, (hx^2 + hy^2)/24 times the sum of the curvatures; a third of it, measured, gives the
force of a fine mesh (tests/physics/test_contact.py). The stand-off falls with the square of the spacing, so that it leaves
what a mesh converges to; flat faces get none (docs/equations.md, C2).
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.sim.features import END
from mjtactile.sim.mesh import MembraneMesh
from mjtactile.types import Array

SHARE = 0.33  # of the facets' mean sagitta
_EVERY, _SETTLE = 0.01, 0.02  # s: how often to look at the contacts, and the time constant with which the stand-off follows


class StandOff:
    """Writes the contact margins of one sensor's vertex spheres, by the curvature of what each of them touches.

    Vertices that touch nothing are ready for what the others touch; without any contact the stand-off goes to zero.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, vertex_geom_ids: np.ndarray, mesh: MembraneMesh):
        self._model, self._data = model, data
        self._first, self._last = int(vertex_geom_ids[0]), int(vertex_geom_ids[-1])  # one block, in the mesh's order
        self._margins = np.asarray(model.geom_margin)[self._first:self._last + 1]
        self._margins[:] = 0.0
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
        self._margins += (goal - self._margins) * min(abs(elapsed) / _SETTLE, 1.0)

    def _curvatures(self) -> Array:
        """Curvature kx + ky, 1/m, of what each vertex touches, or the others' mean where it touches nothing."""
        contact = self._data.contact
        pairs = contact.geom
        mine = (pairs >= self._first) & (pairs <= self._last)  # (ncon, 2)
        rows = np.flatnonzero(mine.any(axis=1))
        if not len(rows):
            return np.zeros(len(self._margins))
        second = mine[rows, 1]
        vertices = np.where(second, pairs[rows, 1], pairs[rows, 0]) - self._first
        others = np.where(second, pairs[rows, 0], pairs[rows, 1])
        found = np.array([curvature(self._model, g, self._data.geom_xmat[g].reshape(3, 3).T @ n) if g >= 0 else 0.0
                          for g, n in zip(others, contact.frame[rows, :3], strict=True)])
        result = np.full(len(self._margins), found.mean())
        result[vertices] = found
        return result


def curvature(model: mujoco.MjModel, geom: int, normal: Array) -> float:
    """Sum of the principal curvatures, 1/m, of a geom where its surface has the unit `normal` (3,), in the geom's frame.

    Zero for faces, and for meshes and height fields, whose curvature is not known.
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return 2 / float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return (1 if abs(normal[2]) < 0.1 else 2) / float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return 1 / float(size[0]) if abs(normal[2]) < END else 0.0
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        point = size**2 * normal / np.linalg.norm(size * normal)  # where the normal is this one
        slope, second = point / size**2, 1 / size**2  # gradient and Hessian of half of sum (x/a)^2
        length = np.linalg.norm(slope)
        return float((length**2 * second.sum() - slope**2 @ second) / length**3)
    return 0.0
