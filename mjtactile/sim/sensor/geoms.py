"""What of a scene a film can rest on: geoms as the film's bodies, by their own formulas."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.film import bodies
from mjtactile.film.bodies import Obstacle, obstacle
from mjtactile.film.live import empty_rows
from mjtactile.sim.sensor import features

_G = mujoco.mjtGeom
_KINDS = {
    int(_G.mjGEOM_SPHERE): ("sphere", 1),
    int(_G.mjGEOM_CAPSULE): ("capsule", 2),
    int(_G.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
    int(_G.mjGEOM_CYLINDER): ("cylinder", 2),
    int(_G.mjGEOM_BOX): ("box", 3),
}
_AWAY = 10.0  # m, where the rows of what is not near are put
_R = slice(4, 13)
_P = slice(13, 16)


class FeltGeoms:
    """The geoms that a film may feel, as rows of bodies in its sensor's frame.

    Attributes:
        ids: (k,) of the geoms.
        rows: (k, NUMBERS), brought up to date by `look`.
        pool: Planes of the meshes' hulls; None: there are none.
        near: (k,) whether each is near enough to touch.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, body: int, reach: float):
        """`body` carries the sensor; a geom is near when it comes within `reach` m of its origin.

        Raises InputError for what a film cannot feel: soft bodies, height fields.
        """
        self.ids: NDArray[np.int64] = features.touching_geoms(model, body)
        made = [_body_of(model, int(geom)) for geom in self.ids]
        filled, self.pool = bodies.pooled(made, (0, 0)) if made else (empty_rows(0), None)
        self.rows = np.ascontiguousarray(filled)
        self.near = np.zeros(len(self.ids), bool)
        self._bodies = model.geom_bodyid[self.ids]
        self._reach2 = (reach + model.geom_rbound[self.ids]) ** 2
        self._data = data
        self._body = body
        _refuse_soft(model)

    def look(self) -> bool:
        """Bring the rows up to the present poses; whether anything is near."""
        data = self._data
        R_WS = data.xmat[self._body].reshape(3, 3)
        p_SO = (data.geom_xpos[self.ids] - data.xpos[self._body]) @ R_WS
        self.near = np.einsum("ki,ki->k", p_SO, p_SO) < self._reach2
        if not self.near.any():
            self.rows[:, _P] = _AWAY
            return False
        R_SO = R_WS.T @ data.geom_xmat[self.ids].reshape(-1, 3, 3)
        self.rows[:, _R] = R_SO.reshape(-1, 9)
        self.rows[:, _P] = np.where(self.near[:, None], p_SO, _AWAY)
        return True

    def near_bodies(self) -> NDArray[np.int64]:
        """The bodies whose geoms are near."""
        return np.unique(self._bodies[self.near])

    def of_body(self, body: int) -> NDArray[np.intp]:
        """Which rows are near geoms of `body`."""
        return np.flatnonzero(self.near & (self._bodies == body))


def _body_of(model: mujoco.MjModel, geom: int) -> Obstacle:
    kind = int(model.geom_type[geom])
    if kind in _KINDS:
        name, count = _KINDS[kind]
        return obstacle(name, model.geom_size[geom, :count])
    if kind == _G.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        return obstacle("mesh", data=model.mesh_vert[first : first + model.mesh_vertnum[mesh]])
    name = model.geom(geom).name or f"geom {geom}"
    what = _G(kind).name.removeprefix("mjGEOM_").lower()
    raise InputError(
        f"{name!r} is a {what}, which a film cannot rest on: leave the sheet on",
        field="--effects -sheet",
    )


def _refuse_soft(model: mujoco.MjModel) -> None:
    """A film rests on rigid bodies alone."""
    for flex in range(model.nflex):
        if model.flex_dim[flex] == 3:
            raise InputError(
                f"{model.flex(flex).name!r} is soft, and a film rests on rigid bodies: leave the "
                "sheet on",
                field="--effects -sheet",
            )
