"""Stand-off of the vertices of a faceted mesh from a curved object.

If the vertices lie on a convex object, the facets between them cut into it. The membrane is then
indented too little. The force of a sphere of 8 mm is 5-8 % low at 13 x 11 vertices.

A membrane whose facets touch the object on average stands off by their mean sagitta. This is (hx^2
+ hy^2)/24 times the sum of the curvatures. A quarter of it gives the force of a fine mesh. The
quarter is determined by measurement (tests/physics/test_contact.py). The stand-off falls with the
square of the spacing. The limit of mesh convergence is therefore unchanged. Flat faces get none
(docs/theory/simulation_contact.md, C2).
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.kernels import bound, kernel
from mjtactile.sim.sensor.contact_list import listed
from mjtactile.sim.sensor.feature_size import END, RESOLVED
from mjtactile.sim.sensor.mesh import MembraneMesh

SHARE = 0.25  # factor on the facets' mean sagitta
# update period, and time constant of the stand-off, s
_EVERY = 0.01
_SETTLE = 0.02
# time constant without contact, s: after a contact is lost for one step, its own stand-off must not
# make it bounce
_RELEASE = 0.2


class StandOff:
    """Contact margins of one sensor's vertex spheres, by the curvature of the touched objects.

    Vertices without contact use the mean of the others. Without contact it decays to zero.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        vertex_geom_ids: np.ndarray,
        mesh: MembraneMesh,
    ):
        self._model = model
        self._data = data
        self._first = int(vertex_geom_ids[0])  # one block, in the mesh's order
        self.margins: Array = np.zeros(len(vertex_geom_ids))
        """Distances (k,) m of the vertices' spheres from the touched object."""
        # sagitta per curvature, m^2: hx^2 + hy^2 is about 2 hx hy
        self._sagitta = SHARE * float(mesh.areas[mesh.interior].mean()) / 12
        # maximum curvature, 1/m: a higher curvature is met by a vertex, not by facets
        self._maximum = 2 / (RESOLVED * mesh.spacing)
        self._time = float(data.time)
        vertices = (self._first, len(self.margins))
        geoms = (model.ngeom, model.geom_type, model.geom_size, data.geom_xmat)
        self._kernel = bound("touched_curvatures", ..., ..., ..., *vertices, *geoms, END, ...)

    def update(self) -> None:
        """Update the margins from the last contacts. Call it every step; it acts every 10 ms."""
        time = float(self._data.time)
        elapsed = time - self._time
        if 0 <= elapsed < _EVERY:
            return
        self._time = time
        bends = self._curvatures()
        goal = self._sagitta * np.where(bends < self._maximum, bends, 0.0)
        settle = _SETTLE if goal.any() else _RELEASE
        self.margins += (goal - self.margins) * min(abs(elapsed) / settle, 1.0)

    def _curvatures(self) -> Array:
        """Return the curvature kx + ky, 1/m, of the object at each vertex."""
        found = np.empty(len(self.margins))
        self._kernel(*listed(self._data), found)
        return found


def curvatures(model: mujoco.MjModel, geoms: NDArray[np.int64], normals: Array) -> Array:
    """Return the sums of the principal curvatures (n,) 1/m of `geoms` (n,).

    They apply at the surface points with the unit `normals` (n, 3), each in its geom's frame. The
    sum is zero for faces, meshes and height fields.
    """
    found = np.empty(len(geoms))
    kernel("curvatures")(
        len(geoms), model.geom_type[geoms], model.geom_size[geoms], normals, END, found
    )
    return found
