"""`SecondObject`: a cube that is placed on the held object during a task.

Until then it floats above the gripper, without contact. Its weight increases while it is lowered.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.task import SampledDisturbance
from mjtactile.core.types import Array
from mjtactile.sim.scenes.objects import PREFIX, ObjectModel, moving_bodies

_NAME = "second object"
_PARKED = 0.4  # height above the fingertips before it is used, m
_FRICTION = [0.6, 0.005, 1e-4]
_GAP = 1e-4  # initial distance above the held object, m
_STOP_TIME = 0.05  # time constant of its motion while it is lowered, s


def add_second_object(
    spec: mujoco.MjSpec, grasped: ObjectModel, event: SampledDisturbance, center: Array
) -> None:
    """Add the cube of `event` above the fingertips' `center` (3,) m.

    Raises InputError for a soft object.
    """
    if grasped.flex_material is not None:
        text = "is soft, and the task puts a second object on it, which requires a rigid one"
        raise InputError(text, source=grasped.path, field="object")
    half = event.values["size"] / 2
    body = spec.worldbody.add_body(name=_NAME, pos=[center[0], center[1], center[2] + _PARKED])
    body.add_freejoint()
    body.gravcomp = 1.0
    body.add_geom(
        name=_NAME,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[half, half, half],
        mass=event.values["added_mass"],
        friction=_FRICTION,
        rgba=[0.55, 0.45, 0.8, 1.0],
    )


class SecondObject:
    """The cube in a compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self._model = model
        self._data = data
        self._body = model.body(_NAME).id
        self._geom = model.geom(_NAME).id
        joint = int(model.body_jntadr[self._body])
        self._qpos = int(model.jnt_qposadr[joint])
        self._qvel = int(model.jnt_dofadr[joint])
        self._below = moving_bodies(model, PREFIX)
        self._is_put = False

    def put(self, done: float) -> None:
        """Lower the cube onto the held object. `done` is the fraction of its weight that acts."""
        data = self._data
        if not self._is_put:
            self._is_put = True
            data.qpos[self._qpos : self._qpos + 7] = [*self._top(), 1.0, 0.0, 0.0, 0.0]
            data.qvel[self._qvel : self._qvel + 6] = 0.0
        self._model.body_gravcomp[self._body] = 1.0 - done
        slowed = -self.mass / _STOP_TIME if done < 1.0 else 0.0
        data.xfrc_applied[self._body, :3] = slowed * data.qvel[self._qvel : self._qvel + 3]

    @property
    def mass(self) -> float:
        """Its mass, kg."""
        return float(self._model.body_mass[self._body])

    @property
    def load(self) -> float:
        """Mass that it adds to the held object at present, kg."""
        if not self._is_put or not self._touches():
            return 0.0
        return self.mass * (1.0 - float(self._model.body_gravcomp[self._body]))

    @property
    def has_fallen(self) -> bool:
        """True if it was placed on the held object and is now below its center."""
        model, data = self._model, self._data
        mass = model.body_mass[self._below]
        height = float(mass @ data.xipos[self._below, 2] / mass.sum())
        return self._is_put and float(data.xpos[self._body, 2]) < height

    def _touches(self) -> bool:
        contact = self._data.contact
        own = contact.geom == self._geom
        owners = self._model.geom_bodyid[contact.geom]
        return bool((own.any(axis=1) & np.isin(owners, self._below).any(axis=1)).any())

    def _top(self) -> Sequence[float]:
        """Return its center (3,), m, when it stands on the held object."""
        model, data = self._model, self._data
        geoms = np.flatnonzero(
            np.isin(model.geom_bodyid, self._below) & ((model.geom_contype & 1) > 0)
        )
        rows = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2]
        centers = data.geom_xpos[geoms, 2] + (rows * model.geom_aabb[geoms, :3]).sum(axis=1)
        tops = centers + (np.abs(rows) * model.geom_aabb[geoms, 3:]).sum(axis=1)
        mass = model.body_mass[self._below]
        x, y = (mass @ data.xipos[self._below] / mass.sum())[:2].tolist()
        return x, y, float(tops.max()) + float(model.geom_size[self._geom, 2]) + _GAP


def second_object(model: mujoco.MjModel, data: mujoco.MjData) -> SecondObject | None:
    """Return the second object of a scene; None without one."""
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, _NAME) < 0:
        return None
    return SecondObject(model, data)
