"""`StateSync`, which runs on Studio's simulation thread.

It copies the session's state to Studio's scene, and the mouse's pull forces to the session.
"""

from __future__ import annotations

import copy
import math
import time as wall
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco.studio import messages, plugin

from mjtactile.studio.callback_guard import guarded
from mjtactile.studio.session_bridge import SessionBridge
from mjtactile.studio.snapshot import FingerSnapshot, StudioSnapshot

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_OFF: Any = mujoco.mjtDisableBit
_STILL = (
    _OFF.mjDSBL_CONSTRAINT
    | _OFF.mjDSBL_CONTACT
    | _OFF.mjDSBL_SPRING
    | _OFF.mjDSBL_DAMPER
    | _OFF.mjDSBL_GRAVITY
    | _OFF.mjDSBL_ACTUATION
    | _OFF.mjDSBL_SENSOR
)
# displayed extent, m, and height of the fingers above its center as a fraction of it
_AROUND = 0.2
_BELOW = 0.25
# viewing angles, deg: aside of the first finger's closing direction, so that its membrane and the
# arrows on it are visible
_ASIDE = 50.0
_ABOVE = -25.0
_PULL_STIFFNESS = 30.0  # stiffness of the mouse's pull, N/m: 60 g are lifted by 2 cm
_HELD = 0.5  # timeout, s, of a pull without messages from the page
_STAGE = """
<mujoco model="no scene"><statistic center="0 0 0.01" extent="0.09"/>
  <visual><headlight diffuse="0.7 0.7 0.7" ambient="0.3 0.3 0.3"/></visual>
  <worldbody><light pos="0 -0.5 1"/></worldbody></mujoco>"""


def displayed_model(model: mujoco.MjModel, fingers: Sequence[FingerSnapshot]) -> mujoco.MjModel:
    """Return a copy of the model for rendering, without forces.

    All poses are in the state. Viewer and page compute each of their frames again; without forces
    this takes an eighth of the time. Their forces would also differ from the session's, whose
    contacts change from step to step.
    """
    shown = copy.copy(model)
    shown.opt.disableflags |= int(_STILL)
    center = np.mean(
        [estimated.pose.p_WS for estimated in fingers if estimated.pose is not None], axis=0
    )
    # initial look-at point of the camera
    shown.stat.center = center - [0.0, 0.0, _BELOW * _AROUND]
    shown.stat.extent = _AROUND
    closes = next(
        (estimated.pose.R_WS[:, 2] for estimated in fingers if estimated.pose is not None), None
    )
    if closes is not None:
        shown.vis.global_.azimuth = math.degrees(math.atan2(closes[1], closes[0])) + _ASIDE
        shown.vis.global_.elevation = _ABOVE
    # MuJoCo's pull stiffness is per kg of mass, which gives no visible effect for objects of some
    # grams
    free = model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    if len(free):
        shown.vis.map.stiffness = _PULL_STIFFNESS / float(model.body_subtreemass[free].min())
    return shown


class StateSync(plugin.SimPlugin):
    """Transfer of the session's state; without a scene, of the estimated membranes."""

    def __init__(self, bridge: SessionBridge):
        self.bridge = bridge
        self.complain = bridge.message
        self._snapshot: StudioSnapshot | None = None
        self._model: Any = None
        self._pulled = 0.0

    def follow(self) -> bool:
        """Publish the session's model if it is new. Return True if there is a new snapshot to show.

        Call it in the loop around `sync`. Studio does not step without a model.
        """
        snapshot = self.bridge.snapshot()
        if snapshot is None:
            return False
        model = None if snapshot.scene is None else snapshot.scene[0]
        if self.handle.model is None or model is not self._model:
            self._model = model
            if model is None:
                shown = mujoco.MjModel.from_xml_string(_STAGE)
            else:
                shown = displayed_model(model, snapshot.fingers)
            self.handle.set_model(shown)
        return snapshot is not self._snapshot

    @messages.handler(priority=messages.Priority.USER)
    def on_load(self, _: messages.LoadModelEvent) -> bool:
        """Reject a model dropped on the page, and "Reload": the scene belongs to the session."""
        self.complain('the scene belongs to the session: choose an object under "another run"')
        return True

    @messages.handler(priority=messages.Priority.USER)
    def on_pull(self, _: messages.PerturbSnapshot) -> None:
        self._pulled = wall.monotonic()

    @messages.handler(priority=messages.Priority.USER)
    @guarded
    def on_step(self, _: messages.StepEvent) -> bool:
        snapshot = self.bridge.snapshot()
        model = self.handle.model
        data = self.handle.data
        if (
            snapshot is not None
            and snapshot is not self._snapshot
            and snapshot.scene is not None
            and snapshot.scene[0] is self._model
        ):
            assert model is not None and data is not None  # it was published
            if wall.monotonic() - self._pulled < _HELD:
                pull = data.xfrc_applied.copy()
            else:
                pull = np.zeros_like(data.xfrc_applied)
            mujoco.mj_setState(model, data, snapshot.scene[1], _STATE)
            data.xfrc_applied[:] = pull
            self.bridge.pull = pull
        self._snapshot = snapshot
        return True
