"""Tests of misuse of a bound sensor and of the environment: one named error each."""

import copy
import dataclasses
import pickle
import warnings

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.gym.env import GraspEnv

SYNTHETIC = "-mesh,-pipeline"
COPIES = [copy.copy, copy.deepcopy, pickle.dumps]


def scene():
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip")
    mount = mjtactile.attach(spec, "dense", site="tip")
    model = spec.compile()
    data = mujoco.MjData(model)
    return spec, mount, model, data, mount.bind(model, data)


@pytest.fixture(scope="module")
def bound():
    return scene()


@pytest.mark.parametrize("copied", COPIES)
def test_a_bound_sensor_cannot_be_copied(bound, copied):
    """Copies shared the model's buffers and gave wrong forces."""
    finger = bound[-1]
    with pytest.raises(InputError, match="SimFinger: cannot be copied or pickled"):
        copied(finger)
    with pytest.raises(InputError, match="TactileSensor: cannot be copied or pickled"):
        copied(finger.sensor)


def test_another_model_or_other_data_is_refused(bound):
    spec, mount, model, data, finger = bound
    other = spec.compile()
    with pytest.raises(InputError, match="finger 'tactile': model: is bound to another model"):
        mjtactile.step(other, data, [finger])
    with pytest.raises(InputError, match="finger 'tactile': data: is bound to another data"):
        mjtactile.step(model, mujoco.MjData(model), [finger])
    with pytest.raises(InputError, match="bind: data: is not the data of this model"):
        mount.bind(model, mujoco.MjData(other))


@pytest.mark.parametrize(
    ("name", "value"),
    [("timestep", 0.002), ("integrator", 0), ("solver", 2), ("cone", 0), ("disableflags", 1)],
)
def test_an_option_changed_after_bind_is_refused(bound, name, value):
    _, _, model, data, finger = bound
    before = getattr(model.opt, name)
    setattr(model.opt, name, value)
    try:
        with pytest.raises(InputError, match=f"option.{name}: was changed from .* after bind"):
            mjtactile.step(model, data, [finger])
        with pytest.raises(InputError, match=f"option.{name}: was changed from .* after bind"):
            finger.before_step()
    finally:
        setattr(model.opt, name, before)
    mjtactile.step(model, data, [finger])


def test_duplicate_fingers_and_other_types_are_refused(bound):
    _, _, model, data, finger = bound
    with pytest.raises(InputError, match="fingers: each finger must be given once"):
        mjtactile.step(model, data, [finger, finger])
    with pytest.raises(
        InputError, match=r"step: fingers: .* not a list or another sequence, each item a SimFinger"
    ):
        mjtactile.step(model, data, [None])


def test_non_finite_values_are_refused_by_name():
    """A membrane at NaN has no contact, which would be reported with status "ok"."""
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip", pos=[np.nan, 0, 0])
    mount = mjtactile.attach(spec, "dense", site="tip", effects="-mesh")
    model = spec.compile()
    with pytest.raises(InputError, match="bind: model: pos of body 'tactile_sensor' is nan"):
        mount.bind(model, mujoco.MjData(model))


@pytest.mark.parametrize("name", ["mocap_pos", "gravity", "time"])
def test_a_non_finite_input_stops_the_scene(name):
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip")
    ball = spec.worldbody.add_body(pos=[0, 0, 0.05], mocap=True)
    ball.add_geom(size=[0.01, 0, 0])
    mount = mjtactile.attach(spec, "dense", site="tip", effects="-mesh")
    model = spec.compile()
    data = mujoco.MjData(model)
    finger = mount.bind(model, data)
    if name == "time":
        data.time = np.nan
    else:
        getattr(model.opt if name == "gravity" else data, name)[:] = np.nan
    with pytest.raises((SimulationError, InputError), match=f"{name}.* (is not finite|to nan s)"):
        mjtactile.step(model, data, [finger], nstep=60)


@pytest.mark.parametrize(
    ("options", "is_noted"), [({"margin": 2e-3}, True), ({"gap": -3e-3}, True), ({}, False)]
)
def test_a_margin_or_a_negative_gap_is_noted(options, is_noted):
    """With 2 mm, a ball presses with 2.2 N on a mesh and with 0.84 N without one."""
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip")
    ball = spec.worldbody.add_body(pos=[0, 0, 0.05])
    ball.add_freejoint()
    ball.add_geom(name="ball", size=[0.01, 0, 0], mass=0.02, **options)
    mount = mjtactile.attach(spec, "dense", site="tip", effects="-mesh")
    model = spec.compile()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mount.bind(model, mujoco.MjData(model))
    noted = ["'ball' has a margin or a negative gap" in str(item.message) for item in caught]
    assert noted == [True] * is_noted


def test_two_sensors_at_the_same_position_are_refused():
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip")
    mounts = [mjtactile.attach(spec, "dense", site="tip", prefix=prefix) for prefix in ("a", "b")]
    model = spec.compile()
    with pytest.raises(InputError, match="bind: model: 'bsensor' is at the same place"):
        mounts[0].bind(model, mujoco.MjData(model))


def test_only_one_thread_can_step_a_scene(bound):
    _, _, model, data, finger = bound
    with finger.exclusive(), pytest.raises(InputError, match="is stepped by another thread"):
        mjtactile.step(model, data, [finger])
    mjtactile.step(model, data, [finger])


@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("membrane", {"thickness": -1.0}, "membrane.thickness_mm: -1000.0 is outside"),
        ("membrane", {"young": np.nan}, "membrane.young_MPa: nan is outside"),
        ("camera", {"width": 10**9}, "camera.width_px: 1000000000 is outside"),
        ("camera", {"rate": "fast"}, "a value has a wrong type"),
        ("membrane", None, "membrane: is None"),
    ],
)
def test_a_sensor_made_in_python_is_checked_as_a_file(part, change, message):
    dense = mjtactile.load_sensor("dense")
    value = change and dataclasses.replace(getattr(dense, part), **change)
    wrong = dataclasses.replace(dense, **{part: value})
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip")
    with pytest.raises(InputError, match=f"SensorDesign: {message}"):
        mjtactile.attach(spec, wrong, site="tip")


def test_the_state_of_another_sensor_is_refused():
    pipelines = [mjtactile.SensingPipeline(mjtactile.load_sensor(n)) for n in ("dense", "paper16")]
    with pytest.raises(InputError, match="state: is of another sensor: 16 markers, not 81"):
        mjtactile.StatefulPipeline(pipelines[0], pipelines[1].initial_state())


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"render_mode": "rgb_array"}, "render_mode: 'rgb_array' needs the effect 'images'"),
        ({"observation": "image"}, "observation: 'image' needs the effect 'images'"),
        ({"observation": "markers"}, "observation: 'markers' needs the effect 'pipeline'"),
        ({"time_limit": 0.0}, "time_limit: 0.0 is not above 0"),
    ],
)
def test_options_without_their_effect_are_refused(option, message):
    with pytest.raises(InputError, match=message):
        GraspEnv(effects=SYNTHETIC, **option)


def test_names_next_to_a_scenario_are_refused():
    with pytest.raises(InputError, match="object: is already in the scenario"):
        GraspEnv(scenario=mjtactile.Scenario(effects=SYNTHETIC), object="cube")


def test_an_environment_reports_each_misuse():
    env = GraspEnv(effects=SYNTHETIC)
    for copied in COPIES:
        with pytest.raises(InputError, match="GraspEnv: cannot be copied or pickled"):
            copied(env)
    with pytest.raises(Exception, match="no episode has started: call reset"):
        env.step(np.zeros(3))
    with pytest.raises(InputError, match=r"options: .* has no effect"):
        env.reset(options={"object": "cube"})
    with pytest.raises(InputError, match="seed: -1 is not a whole number"):
        env.reset(seed=-1)
    env.close()
    for use in (env.reset, env.render, lambda: env.step(np.zeros(3))):
        with pytest.raises(InputError, match="Grasp-v0: is closed"):
            use()
