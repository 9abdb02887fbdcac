"""Objects with joints on a sensor in MuJoCo Warp: damping of their parts, as on the CPU."""

import warnings

import mujoco
import numpy as np
import pytest

import mjtactile

pytest.importorskip("mujoco_warp")

import mujoco_warp as mjw
import warp as wp

import mjtactile.warp

pytestmark = pytest.mark.slow(20)  # compiling MuJoCo Warp takes half a minute

# two blocks, or one of them, on the membrane
SCENE = """
<mujoco>
  <worldbody>
    <site name="tip"/>
    <body name="object" pos="-0.005 0 {z}">
      <freejoint/>
      <geom type="box" size="0.0035 0.004 0.004" mass="0.02"/>
      <body name="other" pos="0.005 0 0">
        <inertial pos="0 0 0" mass="0.002" diaginertia="1e-7 1e-7 1e-7"/>
        <joint name="bend" type="hinge" axis="0 1 0" damping="1e-4"/>
        <body name="end" pos="0.003 0 {rise}">
          <joint name="turn" type="ball"/>
          <joint name="slide" type="slide" axis="0.6 0 0.8"/>
          <geom type="box" size="0.0035 0.004 0.004" mass="0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def scene(**values):
    spec = mujoco.MjSpec.from_string(SCENE.format(**values))
    mjtactile.configure_options(spec, 0.00208)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", effects="-mesh")
    return spec.compile(), tip


@pytest.mark.parametrize(
    "places", [{"z": 0.0064, "rise": 0.0}, {"z": 0.0084, "rise": -0.002}], ids=["both", "one"]
)
def test_joints_inside_an_object_are_damped_as_on_the_cpu(places):
    model, tip = scene(**places)
    data = mujoco.MjData(model)
    with warnings.catch_warnings(action="ignore"):
        finger = tip.bind(model, data)
    own = model.dof_damping.reshape(-1).copy()
    mujoco.mj_forward(model, data)
    finger.sensor.update()
    expected = model.dof_damping.reshape(-1).copy()
    # parts side by side by 16 times as much
    assert (expected[6:] > 1.01 * own[6:]).all()
    model, tip = scene(**places)
    model.opt.disableflags = 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with wp.ScopedDevice("cpu"):
        m, d = mjw.put_model(model), mjw.put_data(model, data, nworld=1, nconmax=32, njmax=96)
        touch = mjtactile.warp.bind(model, m, d, [tip])
        # as on the CPU, the chamber is sealed under the object
        for sealed in (0, 1):
            touch.sealed.fill_(sealed)
            for _ in range(20):  # to equilibrium
                mjw.forward(m, d)
        found = m.dof_damping.numpy()[0].copy()
        for _ in range(240):
            mjw.step(m, d)
        speed = np.abs(d.qvel.numpy()[0])
    # 0.1 %: sticking stiffness by conjugate gradients
    assert found[6:] == pytest.approx(expected[6:], rel=5e-3)
    assert np.isfinite(speed).all()
    assert touch.failures() == 0
