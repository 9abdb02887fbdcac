"""Tests of `attach`, `bind`, `step`, `touch` in a scene stepped by the user."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.sim import ground_truth

G = 9.81  # gravity, m/s^2
SCENE = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
 <body name="table" pos="0 0 0.1"><geom type="box" size="0.1 0.1 0.01"/><site name="here" pos="-0.04 0 0.06"/>
  <site name="there" pos="0.04 0 0.06"/></body>
 <body name="ball" pos="-0.04 0 {height}"><joint type="slide" axis="0 0 1"/><geom size="0.02" mass="0.05"/></body>
</worldbody></mujoco>"""
# heights of the ball, m; the first touches the bulge from the start
ON_THE_SENSOR = 0.182
IN_THE_AIR = 0.3


def scene(height=IN_THE_AIR, sites=("here",), gravity=G):
    spec = mujoco.MjSpec.from_string(SCENE.format(height=height))
    mjtactile.configure_options(spec)
    spec.option.gravity = [0.0, 0.0, -gravity]
    mounts = [mjtactile.attach(spec, "dense", site=site, prefix=f"{site}/") for site in sites]
    model = spec.compile()
    data = mujoco.MjData(model)
    return SimpleNamespace(
        model=model, data=data, fingers=[mount.bind(model, data) for mount in mounts], mounts=mounts
    )


def run(s, seconds):
    mjtactile.step(s.model, s.data, s.fingers, nstep=round(seconds / s.model.opt.timestep))


@pytest.fixture(scope="module")
def loaded():
    """Provide a ball that lies on one of two sensors before they are bound."""
    s = scene(ON_THE_SENSOR, sites=("here", "there"))
    run(s, 0.8)
    return s


def test_a_weight_present_at_binding_is_estimated(loaded):
    touch = loaded.fingers[0].touch
    assert touch.touching
    assert touch.force_normal == pytest.approx(0.05 * G, abs=0.03)  # guaranteed in any scene
    assert not loaded.fingers[1].touch.touching


def test_mujoco_sensors_report_the_same_values(loaded):
    for finger in loaded.fingers:
        touch = finger.touch
        np.testing.assert_array_equal(
            loaded.data.sensor(finger.name + "/wrench").data, touch.traction.wrench
        )
        assert loaded.data.sensor(finger.name + "/touching").data[0] == touch.touching
        assert loaded.data.sensor(finger.name + "/pressure").data[0] == finger.gauge_pressure
    before = loaded.data.sensordata.copy()
    mujoco.mj_forward(loaded.model, loaded.data)
    np.testing.assert_array_equal(loaded.data.sensordata, before)


def test_a_sensor_starts_inflated_sealed_and_at_rest():
    s = scene(gravity=0.0)
    finger = s.fingers[0]
    height = finger.sensor.height_at(0, 0)
    pressure = finger.gauge_pressure
    # the membrane was still settling by some nm when its valve closed
    assert pressure == pytest.approx(finger.design.chamber.supply_gauge, rel=1e-4)
    assert not finger.sensor.valve_is_open
    assert abs(finger.touch.force_normal) < 0.03
    run(s, 0.3)
    # at the step's tolerance of 1e-7 the deviation from equilibrium is smaller
    assert finger.sensor.height_at(0, 0) == pytest.approx(height, abs=1e-6)
    assert finger.gauge_pressure == pytest.approx(pressure, abs=1.0)


def test_images_are_rendered_at_their_rate():
    s = scene(gravity=0.0)
    finger = s.fingers[0]
    times = []
    while s.data.time < 0.5:
        mjtactile.step(s.model, s.data, s.fingers)
        times.append(finger.image.time)
        assert finger.touch.age == pytest.approx(s.data.time - finger.image.time)
    observed = np.unique(times)
    assert len(observed) == 1 + int(0.5 * finger.design.camera.rate)  # one more image, at the start
    assert finger.touch.age <= 1 / finger.design.camera.rate


def test_a_reset_restores_the_initial_state():
    s = scene(ON_THE_SENSOR)
    run(s, 0.3)
    first = s.fingers[0].touch.force_normal
    mujoco.mj_resetData(s.model, s.data)
    with pytest.raises(InputError, match=r"here.*time decreased.*reset\(\)"):
        _ = s.fingers[0].touch
    with pytest.raises(InputError, match=r"time decreased"):
        run(s, 0.1)
    s.fingers[0].reset()
    run(s, 0.3)
    assert s.fingers[0].touch.force_normal == first  # bit-identical, including the noise


def test_binding_again_is_a_fresh_start_also_while_a_sensor_sleeps():
    s = scene(gravity=0.0)
    run(s, 0.4)
    assert s.fingers[0].sensor.is_asleep
    again = s.mounts[0].bind(s.model, s.data)
    assert again.gauge_pressure == s.fingers[0].gauge_pressure


def test_a_missing_step_is_reported_and_not_estimated():
    s = scene(sites=("here", "there"))
    mujoco.mj_step(s.model, s.data, 5)
    with pytest.raises(InputError, match=r"'here'.*is at 0 s.*0\.02 s.*mjtactile\.step"):
        _ = s.fingers[0].touch
    s = scene(sites=("here", "there"))
    mjtactile.step(s.model, s.data, s.fingers[:1], nstep=5)
    with pytest.raises(InputError, match="'there'"):
        _ = s.fingers[1].touch
    with pytest.raises(InputError, match="'there'"):
        run(s, 0.1)


def test_a_user_loop_has_the_same_estimates():
    one = scene(ON_THE_SENSOR)
    other = scene(ON_THE_SENSOR)
    run(one, 0.2)
    while other.data.time < one.data.time:
        other.fingers[0].before_step()
        mujoco.mj_step1(other.model, other.data)
        mujoco.mj_step2(other.model, other.data)
        other.fingers[0].after_step()
    assert other.fingers[0].touch.force_normal == one.fingers[0].touch.force_normal


def test_an_invalid_state_stops_the_scene():
    s = scene()
    run(s, 0.02)
    s.data.qvel[0] = np.nan
    with pytest.raises(SimulationError, match="not finite"):
        run(s, 0.1)


def test_misuse_is_reported_in_one_line():
    s = scene()
    with pytest.raises(InputError, match="other data"):
        mjtactile.step(s.model, mujoco.MjData(s.model), s.fingers)
    spec = mujoco.MjSpec.from_string(SCENE.format(height=IN_THE_AIR))
    with pytest.raises(InputError, match="integrator"):
        mjtactile.attach(spec, "dense", site="here")
    mjtactile.configure_options(spec)
    with pytest.raises(InputError, match=r"nowhere.*here"):
        mjtactile.attach(spec, "dense", site="nowhere")
    model = spec.compile()
    with pytest.raises(InputError, match="compile it from the spec"):
        s.mounts[0].bind(model, mujoco.MjData(model))


@pytest.mark.parametrize(
    "option", [{}, {"impratio": 50.0}, {"density": 1.2, "viscosity": 2e-5}, {"timestep": 2e-3}]
)
def test_options_of_a_scene_do_not_change_the_force(option):
    spec = mujoco.MjSpec.from_string(SCENE.format(height=ON_THE_SENSOR))
    mjtactile.configure_options(spec)
    for name, value in option.items():
        setattr(spec.option, name, value)
    mount = mjtactile.attach(spec, "dense", site="here")
    model = spec.compile()
    data = mujoco.MjData(model)
    finger = mount.bind(model, data)
    mjtactile.step(model, data, [finger], nstep=round(0.8 / model.opt.timestep))
    world = SimpleNamespace(model=model, data=data, sensors=[finger.sensor])
    # the ball is at rest
    assert -ground_truth.contact_force(world, 0)[2] == pytest.approx(0.05 * G, abs=0.01)
    assert finger.touch.force_normal == pytest.approx(0.05 * G, abs=0.03)
