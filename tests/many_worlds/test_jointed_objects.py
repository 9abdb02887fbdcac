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


def test_the_force_at_a_border_of_two_bodies_is_that_of_the_cpu():
    """Nodes next to the border of two overlapping balls carry a part of both."""
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec, 0.00208)
    tip = mjtactile.attach(
        spec, "dense", site=spec.worldbody.add_site(name="tip"), prefix="tip/", effects="-mesh"
    )
    for sign in (-1.0, 1.0):
        body = spec.worldbody.add_body(pos=[sign * 3e-4 + 5e-4, 0.0, 0.0215], mocap=True)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    with warnings.catch_warnings(action="ignore"):
        finger = tip.bind(model, data)
    mujoco.mj_forward(model, data)
    for _ in range(3):
        finger.sensor.update()
    touching = finger.sensor._patches["touching"] > 0
    expected = finger.sensor._patches["wrench"][touching, 2]
    model.opt.disableflags = 0
    with wp.ScopedDevice("cpu"):
        m, d = mjw.put_model(model), mjw.put_data(model, data, nworld=1, nconmax=32, njmax=96)
        touch = mjtactile.warp.bind(model, m, d, [tip])
        for sealed in (0, 1):  # as on the CPU
            touch.sealed.fill_(sealed)
            for _ in range(20):  # to equilibrium
                mjw.forward(m, d)
        patches = touch.membrane_patches.numpy()[0]
    found = patches["force"][patches["touches"] != 0, 2]
    # single precision; a node at the border carries 20 to 40 mN
    assert found == pytest.approx(expected, abs=1e-3)
