"""Membranes in scenes of MuJoCo Warp: statics, the same scene on the CPU, worlds that differ."""

import warnings

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile import InputError

pytest.importorskip("mujoco_warp")

import mujoco_warp as mjw
import warp as wp

import mjtactile.warp

pytestmark = pytest.mark.slow(15)  # compiling MuJoCo Warp takes half a minute

STEP = 0.00208
SCENE = """
<mujoco>
  <worldbody>
    <site name="tip"/>
    <body name="object" pos="{x} 0 {z}">
      <freejoint/>
      <geom type="{kind}" size="{size}" mass="{mass}"/>
    </body>
  </worldbody>
</mujoco>
"""
BOX = {"kind": "box", "size": "0.008 0.006 0.01", "x": 0.0, "z": 0.0131, "mass": 0.03}


def scene(**values):
    """Return the model of an object above a sensor that faces up, and the sensor."""
    spec = mujoco.MjSpec.from_string(SCENE.format(**values))
    mjtactile.configure_options(spec, STEP)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", effects="-mesh")
    model = spec.compile()
    model.opt.disableflags = 0  # MuJoCo Warp has no `autoreset`
    return model, tip


def worlds_of(model, tip, count):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    m, d = mjw.put_model(model), mjw.put_data(model, data, nworld=count, nconmax=32, njmax=96)
    return m, d, mjtactile.warp.bind(model, m, d, [tip])


def first_step(m, d):
    """Make a step and return a function that makes the next ones.

    It launches recorded kernels. Python takes three quarters of `mjw.step` without a GPU.
    """
    mjw.step(m, d)  # compiles; a capture cannot
    with wp.ScopedCapture() as capture:
        mjw.step(m, d)
    return lambda: wp.capture_launch(capture.graph)


@pytest.fixture(autouse=True)
def on_the_cpu():
    with wp.ScopedDevice("cpu"):
        yield


def test_a_box_rests_by_its_weight_and_worlds_differ_only_in_their_parameters():
    """The first world also has the forces of MuJoCo."""
    model, tip = scene(**BOX)
    m, d, touch = worlds_of(model, tip, 3)
    mass = m.body_mass.numpy().repeat(3, axis=0)
    mass[1, model.body("object").id] *= 2  # without compiling
    m.body_mass = wp.array(mass.astype(np.float32), dtype=float)
    forces, heights = [], []
    step = first_step(m, d)
    for _ in range(900):
        step()
        forces.append(-float(touch.wrench.numpy()[0, 0, 2]))
        heights.append(float(d.qpos.numpy()[0, 2]))
    compare_with_cpu(forces[:600], heights[599])
    wrench, pressure = touch.wrench.numpy(), touch.pressure.numpy()
    weight = 0.03 * 9.81 * np.array([1.0, 2.0, 1.0])
    # the box still swings by a few micrometers
    assert -wrench[:, 0, 2] == pytest.approx(weight, rel=0.01)
    assert np.abs(wrench[:, 0, :2]).max() < 2e-3
    assert (wrench[0] == wrench[2]).all() and (pressure[0] == pressure[2]).all()
    assert pressure[1, 0] > pressure[0, 0] > 1000
    assert touch.failures() == 0
    before = touch.pressure.numpy()[1, 0]
    touch.reset(wp.array([True, False, False], dtype=bool))
    assert touch.pressure.numpy()[0, 0] == pytest.approx(1000)
    assert touch.pressure.numpy()[1, 0] == before


@pytest.mark.parametrize(
    "floor",
    [
        '<geom type="plane" size="1 1 0.1" pos="0.3 0.2 0"/>',
        '<geom type="box" size="0.5 0.4 0.02" pos="0.2 0.1 -0.02"/>',
    ],
    ids=["floor", "table"],
)
def test_a_floor_behind_a_tilted_sensor_does_not_touch_it(floor):
    """The sensor faces sideways, its housing 1 mm above the floor, which is behind the membrane.

    The floor's bounding box, as seen from the sensor, is in front, too.
    """
    design, tilt = mjtactile.load_sensor("dense"), np.radians(89.0)
    half = design.frame.length / 2 + design.frame.rim
    height = half * np.sin(tilt) + design.camera.distance * np.cos(tilt) + 1e-3
    spec = mujoco.MjSpec.from_string(f"""<mujoco><compiler angle="radian"/><worldbody>{floor}
      <body pos="0 0 {height}" euler="0 {tilt} 0"><joint type="slide" axis="0 1 0"/>
       <site name="tip"/></body></worldbody></mujoco>""")
    mjtactile.configure_options(spec, STEP)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", effects="-mesh")
    model = spec.compile()
    model.opt.disableflags = 0
    m, d, touch = worlds_of(model, tip, 1)
    for _ in range(3):
        mjw.step(m, d)
    assert not touch.wrench.numpy().any()
    assert touch.status.numpy().max() == 0


def compare_with_cpu(forces, height):
    """Compare forces, N, and final height, m, with MuJoCo."""
    model, tip = scene(**BOX)
    data = mujoco.MjData(model)
    with warnings.catch_warnings(action="ignore"):
        finger = tip.bind(model, data)
    same = []
    for _ in forces:
        mjtactile.step(model, data, [finger])
        same.append(finger.ground_truth_wrench())
    same = -np.array(same)[:, 2]
    # after the landing; the two differ in rounding and in tolerances of their solvers
    assert np.sqrt(np.mean((np.array(forces) - same)[300:] ** 2)) < 0.02 * 0.03 * 9.81
    assert height == pytest.approx(float(data.qpos[2]), abs=2e-5)


def test_an_object_that_is_held_does_not_creep():
    """A flat disc under its weight; gravity then gets a component along the membrane."""
    disc = {"kind": "cylinder", "size": "0.009 0.002", "x": 0.0, "z": 0.0051, "mass": 0.05}
    m, d, touch = worlds_of(*scene(**disc), 1)
    step = first_step(m, d)
    for _ in range(300):
        step()
    m.opt.gravity.assign(np.array([[0.0, -1.0, -9.81]], np.float32))
    for _ in range(600):
        step()
    start = d.qpos.numpy()[0, :3].copy()
    for _ in range(240):
        step()
    moved = d.qpos.numpy()[0, :3] - start
    assert touch.wrench.numpy()[0, 0, 1] == pytest.approx(-0.05, rel=0.02)
    assert touch.slides.numpy()[0, 0] == 0
    assert np.abs(moved).max() < 0.5e-6  # 1 um/s


WALL = """
<mujoco>
  <asset><mesh name="wedge" vertex="-.004 -.006 0 .004 -.006 0 -.004 .006 0 .004 .006 0 0 0 .01"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1" pos="0 0 {floor}" zaxis="0 0 -1"/>
    <geom name="wedge" type="mesh" mesh="wedge" pos="0.001 0 {wedge}"/>
    <geom name="far" type="box" size="0.3 0.3 0.1" pos="0 0.5 0"/>
    <body name="hand"><joint type="slide" axis="0 0 1"/><site name="tip"/><geom size="0.001" contype="0" mass="1"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("heights", [(0.0015, 1.0), (1.0, 0.0015)], ids=["plane", "mesh"])
def test_a_moving_sensor_touches_geoms_fixed_to_the_world(heights):
    """1 % of the force: the tolerances of both solvers. First contact has no shear on the CPU."""
    model, tip = bound_to_hand(WALL.format(floor=heights[0], wedge=heights[1]))
    data = mujoco.MjData(model)
    with warnings.catch_warnings(action="ignore"):
        finger = tip.bind(model, data)
    mujoco.mj_forward(model, data)
    finger.sensor.update()
    expected = finger.ground_truth_wrench()
    m, d, touch = worlds_of(model, tip, 1)
    touch.sealed.zero_()  # as on the CPU, which seals the chamber in contact
    touch.friction.zero_()
    for _ in range(20):
        mjw.forward(m, d)
    assert touch.wrench.numpy()[0, 0] == pytest.approx(expected, rel=0.01, abs=2e-5)


def bound_to_hand(text):
    spec = mujoco.MjSpec.from_string(text)
    mjtactile.configure_options(spec, STEP)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", effects="-mesh")
    model = spec.compile()
    model.opt.disableflags = 0
    return model, tip


def test_unsupported_geoms_are_named():
    spec = mujoco.MjSpec.from_string(SCENE.format(**BOX))
    mjtactile.configure_options(spec, STEP)
    meshed = mjtactile.attach(spec, "dense", site="tip", prefix="tip/")
    model = spec.compile()
    model.opt.disableflags = 0
    with pytest.raises(InputError, match="has a mesh, which runs on the CPU only"):
        mjtactile.warp.bind(model, None, None, [meshed])
    with pytest.raises(InputError, match="at least one sensor"):
        mjtactile.warp.bind(model, None, None, [])
    bead = {"kind": "sphere", "size": "0.001", "x": 0.0, "z": 0.1, "mass": 0.01}
    with pytest.raises(
        InputError, match=r"geom 0 of object: is a ball of 1\.0 mm radius; at least"
    ):
        worlds_of(*scene(**bead), 1)
