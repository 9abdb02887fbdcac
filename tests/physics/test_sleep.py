"""Tests of sleep: a sensor without contact adds no variables to the solve, and wakes in its
previous state."""

import mujoco
import numpy as np
import pytest

from benchmarks.scenes import rigid_pads
from benchmarks.simulation_cases import HOLD_FORCE
from mjtactile.core.design import load_sensor
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.sleep import NEAR

CHANGED = (
    "geom_gap",
    "geom_margin",
    "geom_conaffinity",
    "body_margin",
    "body_conaffinity",
    "flex_conaffinity",
    "qpos_spring",
    "jnt_stiffness",
    "tendon_num",
    "flex_rigid",
)
AWAY = 0.02  # height above first touch, m


def inflated(**how):
    world = PressWorld("dense", Indenter.parse("sphere:8"), mesh=(11, 9), **how)
    world.inflate(1000.0, seal=True)
    world._place(world._touch_height + AWAY)
    return world


def asleep():
    world = inflated()
    world.step(60)
    assert world.sensors[0].is_asleep
    return world


def test_a_press_after_sleep_is_the_press_without_it():
    worlds = inflated(), inflated()
    worlds[0].sensors[0].sleepy = False
    pressed = []
    for world in worlds:
        world.step(60)
        world._find_touch()
        world.press(2e-3)
        pressed.append((-ground_truth.contact_force(world, 0)[2], world.marker_poses(0)[0]))
    # friction retains the noise at first touch
    assert pressed[1][0] == pytest.approx(pressed[0][0], rel=0.01)
    np.testing.assert_allclose(pressed[1][1], pressed[0][1], atol=2e-5)  # the same: 1 % of 2 mm


def test_an_open_valve_keeps_the_sensor_awake():
    """The valve opens right before the check for sleep, when its pressure has not reached the
    membrane."""
    world = inflated()
    sensor = world.sensors[0]
    while sensor._sleeper._calm < 2 or world.time - sensor._sleeper._time < 0.01:
        world.step()
    sensor.open_valve(3000.0)
    world.step(20)
    assert sensor.gauge_pressure == 3000.0


def test_waking_restores_the_state_and_the_model():
    world = inflated()
    sensor = world.sensors[0]
    before = {name: getattr(world.model, name).copy() for name in CHANGED}
    while not sensor.is_asleep:
        p_SV = sensor.p_SV
        pressure = sensor.gauge_pressure
        world.step()
    world.step(50)
    # springs that carry the membrane's weight yield by 1 nm
    np.testing.assert_allclose(sensor.p_SV, p_SV, atol=2e-9)
    sensor.wake()
    np.testing.assert_array_equal(sensor.p_SV, p_SV)
    # the last step before, at rest
    assert sensor.gauge_pressure == pytest.approx(pressure, abs=0.01)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(world.model, name), value, err_msg=name)


def test_a_sleeping_sensor_has_no_constraints():
    world = asleep()
    model = world.model
    data = world.data
    sensor = world.sensors[0]
    world.step()
    assert not model.tendon_num.any() and model.flex_rigid.all()
    assert not data.qfrc_applied[sensor.dofs].any()
    assert np.abs(data.qvel[sensor.dofs]).max() < 1e-9  # speed, m/s
    assert data.nefc == 0


def test_a_sensor_wakes_before_contact():
    world = asleep()
    height = AWAY
    while world.sensors[0].is_asleep and height > 0:
        height -= 2e-4
        world._place(world._touch_height + height)
        world.step()
    # a ninth of the vertices check for objects; on this mesh no vertex is farther than 8.5 mm from
    # one of them, which the margin covers with a fifth to spare
    assert NEAR < height < NEAR + 1.2 * 8.5e-3
    assert not np.any(ground_truth.contact_force(world, 0))


def push(world):
    world.data.xfrc_applied[world.model.geom_bodyid[world.sensors[0].vertex_geom_ids[20]], 2] = 1e-3


@pytest.mark.parametrize("at", [(0.0, 0.0), (15e-3, 10e-3), (-16e-3, 3e-3)])
def test_a_pin_at_any_position_wakes_the_sensor(at):
    world = PressWorld("dense", Indenter.parse("cylinder:1"), at=at, mesh=(11, 9))
    world.inflate(500.0, seal=True)
    world._place(world._touch_height + AWAY)
    world.step(60)
    assert world.sensors[0].is_asleep
    for height in np.arange(AWAY, 1e-3, -5e-4):
        world._place(world._touch_height + height)
        world.step()
    assert not world.sensors[0].is_asleep


@pytest.mark.parametrize(
    "disturb",
    [
        push,
        lambda w: w.sensors[0].open_valve(900.0),
        lambda w: w.sensors[0].puncture(1e-9),
        lambda w: w.model.opt.gravity.__setitem__(0, 1.0),
        lambda w: w.set_control(w.model.actuator("carrier").id, 1e-4),
    ],
)
def test_a_disturbance_wakes_the_sensor(disturb):
    world = asleep()
    disturb(world)
    world.step(3)  # the frame's velocity is known a step late
    assert not world.sensors[0].is_asleep


def test_a_shaken_sensor_does_not_sleep():
    world = inflated(shake=(1e-3, 10.0))
    for _ in range(100):
        world.step()
        assert not world.sensors[0].is_asleep


def test_a_scene_without_sensors_is_a_bare_mujoco_scene():
    world = rigid_pads.hold(load_sensor("dense"), "egg", 1 / 240, HOLD_FORCE)
    twin = mujoco.MjData(world.model)
    mujoco.mj_copyData(twin, world.model, world.data)
    for _ in range(50):
        mujoco.mj_step(world.model, twin)
    world.step(50)
    np.testing.assert_array_equal(world.data.qpos, twin.qpos)
    assert world.step_count and world.time == twin.time
