"""Tests of Studio's initial view, and of the force of its mouse."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mjtactile.studio.state_sync import displayed_model

SCENE = """
<mujoco><worldbody>
  <body name="hand"><joint type="slide" axis="0 0 1"/><geom size="0.02" mass="2"/></body>
  <body name="object" pos="0.1 0 0"><freejoint/><geom size="0.01" mass="0.06"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("turned", [0.0, 90.0])
def test_membranes_are_shown_from_the_side_and_the_mouse_moves_light_objects(turned):
    model = mujoco.MjModel.from_xml_string(SCENE)
    angle = np.radians(turned)
    closes = np.array([np.cos(angle), np.sin(angle), 0.0])
    R_WS = np.column_stack([[0, 0, 1], np.cross(closes, [0, 0, 1]), closes])
    estimated = [SimpleNamespace(pose=SimpleNamespace(p_WS=np.zeros(3), R_WS=R_WS))]
    shown = displayed_model(model, estimated)
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(shown, camera)
    look = np.radians(camera.azimuth)
    # neither along the way in which it closes nor across it
    assert abs(np.cos(look) * closes[0] + np.sin(look) * closes[1]) == pytest.approx(0.64, abs=0.1)
    # pulled at by 1 cm, as MuJoCo reckons it
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pull = mujoco.MjvPerturb()
    pull.select = model.body("object").id
    pull.active = int(mujoco.mjtPertBit.mjPERT_TRANSLATE)
    pull.localmass = 0.06
    pull.refselpos = data.xipos[pull.select] + [0.0, 0.0, 0.01]
    mujoco.mjv_applyPerturbForce(shown, data, pull)
    # stiffness 30 N/m; MuJoCo adds damping, which is zero at rest
    assert data.xfrc_applied[pull.select, 2] == pytest.approx(0.3, rel=0.01)
