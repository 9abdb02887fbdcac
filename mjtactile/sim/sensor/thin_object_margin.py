"""Contact margin for fast thin objects.

Triangles make contact early, by the motion in one step. Otherwise a wire of 0.3 mm radius at 0.1
m/s would be beyond the membrane before its contact is detected. The margin returns to zero when the
object stops.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core import geometry
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.sim.sensor import feature_size
from mjtactile.sim.sensor.mesh import MembraneMesh

_STEPS = 1.5  # margin relative to the displacement per step
_MARGIN_MAX = 1e-3  # maximum margin, m: at 4 ms, for 0.17 m/s
_BACK = 2e-6  # decrease of the margin per step, m: contact must not be lost for a step, in
# which a membrane under pressure jumps past a thin object; the contact depth is 20 um
# (CONTACT_DEPTH)
_NEAR = 2e-3  # distance, m, beyond which no contact occurs in the next steps
_PRIMITIVES = (int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CAPSULE))
_CORE = 1e-6  # half the thickness of the triangles themselves, m


class ThinObjectMargin:
    """The contact margin of one sensor's triangles. Call `update` before every step."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        body_id: int,
        flex_id: int,
        mesh: MembraneMesh,
    ):
        self._model = model
        self._data = data
        self._body = body_id
        self._flex = flex_id
        self._thin = [
            int(geom)
            for geom in feature_size.touching_geoms(model, body_id)
            if feature_size.feature_radius(model, int(geom)) < feature_size.RESOLVED * mesh.spacing
        ]
        self._step = float(model.opt.timestep)
        self._margin = 0.0
        # half of the membrane's thickness becomes margin: contacts keep a distance and a
        # well-defined normal
        self.skin = float(model.flex_radius[flex_id]) - _CORE + float(model.flex_margin[flex_id])
        model.flex_radius[flex_id] = _CORE
        model.flex_margin[flex_id] = self.skin

    def update(self, p_SV: Array) -> None:
        """Adapt the margin to thin objects near the vertices at `p_SV` (n, 3) m."""
        if not self._thin:
            return
        speed = max((self._closing_speed(geom, p_SV) for geom in self._thin), default=0.0)
        requested = min(_STEPS * speed * self._step, _MARGIN_MAX)
        margin = max(requested, self._margin - _BACK, 0.0)
        if margin != self._margin:
            self._margin = margin
            self._model.flex_margin[self._flex] = self.skin + margin

    def _closing_speed(self, geom: int, p_SV: Array) -> float:
        """Return the speed, m/s, at which a near geom approaches the glass; 0 for all others."""
        data = self._data
        R_WS = data.xmat[self._body].reshape(3, 3)
        p_WS = data.xpos[self._body]
        center = (data.geom_xpos[geom] - p_WS) @ R_WS
        extent = self._model.geom_rbound[geom] + _NEAR
        if np.linalg.norm(p_SV - center, axis=1).min() > extent:
            return 0.0
        p_WV = p_WS + p_SV @ R_WS.T
        away = feature_size.box_distances(self._model, data, geom, p_WV)
        nearest = int(away.argmin())
        if away[nearest] > _NEAR:
            return 0.0
        point = p_WV[nearest]
        velocity = self._velocity(int(self._model.geom_bodyid[geom]), point)
        relative = velocity - self._velocity(self._body, point)
        return max(-float(relative @ R_WS[:, 2]), 0.0)

    def _velocity(self, body: int, point: Array) -> Array:
        """Return the velocity (3,) m/s, frame W, of the point (3,) m of a MuJoCo body."""
        data = self._data
        angular_velocity = data.cvel[body, :3]
        arm = point - data.subtree_com[self._model.body_rootid[body]]
        return data.cvel[body, 3:] + geometry.cross(angular_velocity, arm)


def refuse_thin(model: mujoco.MjModel, carrier: int, mesh: MembraneMesh) -> None:
    """Raise InputError for a thin box or capsule, whose triangle contact MuJoCo would miss."""
    for geom in feature_size.touching_geoms(model, carrier):
        if int(model.geom_type[geom]) not in _PRIMITIVES:
            continue
        if feature_size.feature_radius(model, int(geom)) < feature_size.SLIPS * mesh.spacing:
            raise InputError(
                f"triangles would miss {feature_size.name_of(model, int(geom))!r}, a thin box "
                "or capsule: use contact 'auto', or model it as a mesh or cylinder",
                source="attach",
                field="contact",
            )
