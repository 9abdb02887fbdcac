"""Results of sensors in MuJoCo Warp: contact, markers, stiffness, `sensordata`; a shared contact."""

import types
import warnings

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.sim.sensor.mesh import MarkerInterpolator, make_mesh
from mjtactile.sim.sensor.quasistatic_geoms import sticking_of
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

pytest.importorskip("mujoco_warp")

import mujoco_warp as mjw
import warp as wp

import mjtactile.warp

pytestmark = pytest.mark.slow(20)  # compiling MuJoCo Warp takes half a minute

STEP = 0.00208
RADIUS = 0.009
SCENE = """
<mujoco>
  <worldbody>
    <site name="tip"/>
    <body name="disc" pos="0.001 0 0.0051">
      <freejoint/>
      <geom type="cylinder" size="0.009 0.002" mass="0.05"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def held():
    """Rest a disc on a sensor, then tilt gravity: the contact sticks and is sheared."""
    spec = mujoco.MjSpec.from_string(SCENE)
    mjtactile.configure_options(spec, STEP)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", effects="-mesh")
    model = spec.compile()
    model.opt.disableflags = 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with wp.ScopedDevice("cpu"):
        m, d = mjw.put_model(model), mjw.put_data(model, data, nworld=1, nconmax=32, njmax=96)
        touch = mjtactile.warp.bind(model, m, d, [tip])
        for gravity in ([0, 0, -9.81], [0.5, -1.0, -9.81]):
            m.opt.gravity = wp.array([gravity], dtype=wp.vec3)
            for _ in range(200):
                mjw.step(m, d)
        membrane = touch.membranes.membrane
        body = model.body("disc").id
        yield types.SimpleNamespace(
            touch=touch,
            d=d,
            membrane=membrane,
            disc=membrane.obstacle(
                "cylinder",
                (RADIUS, 0.002),
                d.xpos.numpy()[0, body].astype(float),
                d.xmat.numpy()[0, body].astype(float),
            ),
            adr=int(model.sensor("tip/wrench").adr[0]),
        )


def test_contact_is_that_of_the_cpu(held):
    state = held.membrane.solve(held.disc)
    touch = held.touch
    # of a flat face, whose edge is found to 1/4096 of a spacing
    assert touch.area.numpy()[0, 0] == pytest.approx(state.area, rel=2e-3)
    assert touch.area.numpy()[0, 0] == pytest.approx(np.pi * RADIUS**2, rel=0.03)
    torque = state.wrench[3:]
    middle = [-torque[1] / state.wrench[2], torque[0] / state.wrench[2]]
    # the slopes of the tilted disc contribute little to the torque
    assert touch.center.numpy()[0, 0, :2] == pytest.approx(middle, abs=5e-5)
    assert touch.slides.numpy()[0, 0] == 0 and touch.slid.numpy()[0, 0] == 0


def test_sensordata_has_the_wrench_the_pressure_and_the_contact(held):
    values = held.d.sensordata.numpy()[0, held.adr : held.adr + 8]
    touch = held.touch
    expected = [*touch.wrench.numpy()[0, 0], touch.pressure.numpy()[0, 0], 1.0]
    assert values == pytest.approx(expected, abs=0)


def test_markers_move_with_the_membrane_and_the_shear(held):
    """The same loads by the CPU's exact compliance and splines."""
    touch, membrane = held.touch, held.membrane
    found = touch.markers().numpy()[0, 0]
    u = touch.membranes.fields.u.numpy()[0].astype(float).reshape(3, *membrane.grid)
    states = touch._physics.states
    load = states.nodes.load.numpy()[0].reshape(2, *membrane.grid)
    fields = touch.membranes.fields
    normal, slopes = fields.force.numpy()[0], (fields.slope_x.numpy()[0], fields.slope_y.numpy()[0])
    tilted = [float((normal * slope).sum()) for slope in slopes]  # frictionless, of a tilted disc
    # single precision
    expected = touch.wrench.numpy()[0, 0, :2] - tilted
    assert load.sum(axis=(1, 2)) == pytest.approx(expected, abs=1e-5)
    inner = load[:, 1:-1, 1:-1].reshape(2, -1).T.ravel()
    shear = (sticking_of(membrane).compliance @ inner).reshape(-1, 2)
    frame = membrane.design.frame
    mesh = make_mesh(frame.length, frame.width, *membrane.grid)
    moved = u.reshape(3, -1).T.copy()
    moved[mesh.interior, :2] += shear
    markers = MarkerInterpolator(mesh, membrane.design.markers.p_SM)
    assert np.abs(shear).max() > 3e-5  # m: not at rest
    # single precision
    assert found == pytest.approx(markers.marker_poses(mesh.p_SV + moved)[0], abs=5e-8)


def test_markers_are_those_of_the_cpu(held, monkeypatch):
    """MuJoCo steps the same scene with its own solver."""
    spec = mujoco.MjSpec.from_string(SCENE)
    mjtactile.configure_options(spec, STEP)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", effects="-mesh")
    model = spec.compile()
    data = mujoco.MjData(model)
    with warnings.catch_warnings(action="ignore"):
        finger = tip.bind(model, data)
    for gravity in ([0, 0, -9.81], [0.5, -1.0, -9.81]):
        model.opt.gravity = gravity
        for _ in range(200):
            mjtactile.step(model, data, [finger])
    found = held.touch.markers().numpy()[0, 0]
    # the CPU's membrane slides along the tilted disc, the device's moves in the plane only
    assert found == pytest.approx(finger.sensor.marker_poses()[0], abs=2e-5)
    assert isinstance(finger.sensor, QuasistaticSensor)
    monkeypatch.setattr(finger.sensor._live, "with_shear", lambda shear: lambda: None)
    assert found == pytest.approx(finger.sensor.marker_poses()[0], abs=8e-6)


def test_stiffness_without_friction_is_the_derivative_of_the_cpu(held):
    touch = held.touch
    friction = touch.friction.numpy().copy()
    with wp.ScopedDevice("cpu"):
        touch.friction.fill_(0.0)
        found = touch.stiffness().numpy()[0, 0]
        touch.friction.assign(friction)
    state = held.membrane.solve(held.disc)
    exact = np.array(held.membrane.derivatives_by_pose(state).wrench).T
    scale = np.array([1, 1, 1, 1e2, 1e2, 1e2])  # lever arm of 1 cm
    error = (found - exact) * np.outer(scale, scale)
    # differences of 20 um, in which the edge of the contact changes
    assert np.abs(error).max() < 0.01 * exact[2, 2]


def test_stiffness_contains_the_shear_of_a_contact_that_sticks(held):
    found = held.touch.stiffness().numpy()[0, 0]
    grip = held.touch._physics.states.patches.numpy()[0, 0]["grip"]
    assert found[[0, 1, 5], [0, 1, 5]] == pytest.approx(np.diag(grip), rel=0.02)
    # the state is untouched
    assert held.touch.stiffness().numpy()[0, 0] == pytest.approx(found, abs=0)
