"""Tests of the emulated as-built sensor: true parameters of a finger, which the host does not
receive."""

import copy
import math
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from emulated import Chambers

from mjtactile.core import geometry, optics, resources, scaled_clock
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.emulator.faults import Faults
from mjtactile.emulator.mechanism import GearedJaws, Jaw
from mjtactile.emulator.servo import EmulatedServo
from mjtactile.emulator.valve import ValveFirmware, framed, unframed
from mjtactile.rig.as_built_sensor import AsBuiltSensor, camera_pose, true_design
from mjtactile.rig.domain_randomization import SampledWorld
from mjtactile.rig.file import ServoConfig, load_rig_file, rig_from_table
from mjtactile.sensing.image.markers import detect
from mjtactile.sim.rendering.renderer import Effects, Renderer
from mjtactile.sim.rig import build_sim_rig

DESIGN = load_sensor("dense")


@pytest.fixture
def table():
    return copy.deepcopy(
        tomllib.loads(resources.find("emulated_as_built", "models/rigs", ".toml").read_text())
    )


def test_the_shipped_as_built_sensors_are_read_with_their_units():
    emulator = load_rig_file("emulated_as_built").emulator
    left = emulator.as_built_sensor("left")
    assert (left.focal_fraction, left.shift, left.valve_zero) == (
        pytest.approx(0.03),
        pytest.approx((4e-4, 0, 0)),
        30.0,
    )
    assert math.degrees(np.linalg.norm(left.tilt)) == pytest.approx(1.0)
    assert emulator.torque_fraction == pytest.approx(0.08)
    true = true_design(DESIGN, left)
    assert (
        true.camera.fx == pytest.approx(1.03 * DESIGN.camera.fx)
        and true.camera.cx == DESIGN.camera.cx + 6
    )
    assert true.membrane.young == pytest.approx(1.15 * DESIGN.membrane.young)
    assert true.markers.radius == pytest.approx(DESIGN.markers.radius + 2e-5)


def test_a_finger_without_an_as_built_sensor_is_as_its_sensor_file_states():
    own = load_rig_file("emulated").emulator.as_built_sensor("right")
    assert true_design(DESIGN, own) == DESIGN
    R, p = camera_pose(DESIGN, own)
    assert np.array_equal(R, np.eye(3)) and np.array_equal(p, DESIGN.camera.p_SC)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("fx_percent", 80.0, "outside"),
        ("center_px", [1.0], "not a list of 2 numbers"),
        ("camera_tilt_deg", [0, "a", 0], "'a'"),
        ("stiffnes_percent", 1.0, "did you mean 'stiffness_percent'"),
    ],
)
def test_a_wrong_field_is_named(table, key, value, message):
    table["emulator"]["as_built"]["left"][key] = value
    with pytest.raises(InputError, match=message) as caught:
        rig_from_table(table, Path("test.toml"))
    assert f"emulator.as_built.left.{key}" in str(caught.value)


def test_a_finger_that_does_not_exist_is_named(table):
    table["emulator"]["as_built"]["middle"] = {}
    with pytest.raises(InputError, match=r"emulator\.as_built\.middle: unknown section"):
        rig_from_table(table, Path("test.toml"))


def test_a_displaced_camera_agrees_with_the_projection():
    """Centers of circles detected in rendered images agree with their projection."""
    own = AsBuiltSensor("left", shift=(4e-4, -2e-4, 3e-4), tilt=(0.0, 0.017, 0.01))
    R_SC, p_SC = camera_pose(DESIGN, own)
    renderer = Renderer(DESIGN, pose=(R_SC, p_SC))
    p_SM = DESIGN.markers.p_SM
    n_S = np.tile([0.0, 0.0, -1.0], (DESIGN.markers.count, 1))
    found = detect(renderer.render(p_SM, n_S, effects=Effects(noise_dn=0.0))).center_px
    expected = optics.project(renderer.camera, geometry.transform(R_SC.T, -R_SC.T @ p_SC, p_SM))
    nearest = np.linalg.norm(found[:, None] - expected, axis=2).min(axis=0)
    # px: a circle's centre is not its image's, by 0.1 px at the corners
    assert nearest.max() < 0.15


def test_the_valve_board_regulates_by_its_own_sensor():
    chambers = Chambers()
    firmware = ValveFirmware(chambers, Faults(), zeros={1: 30.0})

    def settle():
        for _ in range(200):  # 4 s of a 50 ms lag
            firmware.tick(scaled_clock.monotonic(), 0.02)

    def ask(text):
        return unframed(
            firmware.reply(framed(f"1 {text}").rstrip(), scaled_clock.monotonic()).rstrip()
        )

    for text in ("vent 1", "limit 1 3000", "beat 60000", "set 1 1000"):
        assert ask(text) == f"1 {text}"
    settle()
    assert chambers.pressures[1] == pytest.approx(970.0, abs=0.1)
    readings = [float(ask("state 1").split()[4]) for _ in range(50)]
    assert np.mean(readings) == pytest.approx(1000.0, abs=4 * 5 / math.sqrt(50))  # 5 Pa of noise
    ask("vent 1")
    settle()
    assert chambers.pressures[1] == pytest.approx(0.0, abs=0.1)


def test_a_servo_with_a_higher_torque_constant_needs_less_current():
    servo = EmulatedServo(1, "XL330-M288")
    strong = EmulatedServo(1, "XL330-M288", torque_fraction=0.08)
    for item in (servo, strong):
        item.follow_load(0.0, 0.0, 0.2, 0.01)
    assert servo.current / strong.current == pytest.approx(1.08)


def test_shafts_with_backlash_turn_before_the_jaws_follow():
    """With a backlash of 1 mm the jaws rest while the shafts cross it, then both move together.

    This also holds after a reversal.
    """
    config = ServoConfig(1, "XL330-M288", per_rad=0.012, zero_ticks=0)
    servo = EmulatedServo(1, "XL330-M288", angle=2.0)
    jaw = Jaw(servo, config, "rig.toml")
    goal = 0.024
    servo.drive = lambda: SimpleNamespace(goal=jaw.angle(goal), torque_max=0.1)
    jaws = GearedJaws([jaw], backlash=1e-3)

    def driven(opening):
        jaws.follow_load(opening, 0.0, 0.0, 0.01)
        return jaws.drive(opening)[0], jaw.part(servo.angle)

    # jaws and shaft are at the goal
    assert driven(0.024) == (pytest.approx(0.024), pytest.approx(0.024, abs=2e-5))
    # 0.3 mm further, within the backlash: the jaws rest, the shaft reaches its goal
    goal = 0.0237
    assert driven(0.024) == (pytest.approx(0.024), pytest.approx(0.0237, abs=2e-5))
    # 3 mm further: the jaws stop half the backlash before the goal, the shaft is ahead by half of
    # it
    goal = 0.021
    assert driven(0.024) == (pytest.approx(0.0215), pytest.approx(0.0235, abs=2e-5))
    assert driven(0.0215) == (pytest.approx(0.0215), pytest.approx(0.021, abs=2e-5))
    # reversed: the shaft crosses the complete backlash before the jaws open
    goal = 0.0218
    assert driven(0.0215)[0] == pytest.approx(0.0215)
    goal = 0.025
    assert driven(0.0215)[0] == pytest.approx(0.0245)


def test_an_as_built_sensor_with_relaxation_is_stiffer_in_a_fast_stretch():
    """Relaxation by 5 % of the long-term stress in each decade from 1 to 1000 s: initially 20 %
    more. The file's modulus is the long-term modulus."""
    design = load_sensor("dense")
    true = true_design(design, AsBuiltSensor("left", creep=0.05))
    assert true.relaxation is not None and true.relaxation.quick == pytest.approx(1.2)
    assert true.membrane == design.membrane
    # an emulated world has relaxation although the sensing file has none
    rig = build_sim_rig(
        Scenario(effects="-images"),
        sampled=SampledWorld(as_built=(AsBuiltSensor("left", creep=0.05),)),
    )
    [left, right] = rig.scene.sensors
    assert left.design.relaxation is not None and right.design.relaxation is None
    assert rig.fingers[0].design.relaxation is None
