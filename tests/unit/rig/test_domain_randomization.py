"""Tests of randomization: names in the files are checked, samples depend on seed and name alone,
and the world has the sampled values."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from mjtactile.core import resources
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.sensor_parts import Chamber
from mjtactile.core.toml import read_toml
from mjtactile.core.types import Command
from mjtactile.rig.as_built_sensor import AsBuiltSensor, marker_radii, true_design
from mjtactile.rig.domain_randomization import (
    CAMERA,
    NONE,
    SECTIONS,
    ObjectChange,
    RigChange,
    Spread,
    load_variation,
    sample_world,
    variation_from_table,
)
from mjtactile.rig.file import load_sim_rig
from mjtactile.sensing.image.markers import detect
from mjtactile.sim.devices import SimGripper
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.rig import build_sim_rig
from mjtactile.sim.scenes.mjcf import change
from mjtactile.sim.scenes.objects import load_object
from mjtactile.sim.sensor.gas import ChamberGas

DESIGN = load_sensor("dense")
FILE = load_sim_rig("sim")
DEFAULT = resources.find("default", "models/randomization", ".toml")


def read(table):
    return variation_from_table(table, Path("my.toml"))


def sampled(table, seed=0):
    return read(table).sample(seed, fingers=("left", "right"), markers=81)


def test_the_shipped_file_randomizes_every_parameter():
    names = {
        f"{section}.{row.key}"
        for section, rows in SECTIONS.items()
        for row in rows
        if section != CAMERA  # off by default
    }
    assert set(load_variation("default").spreads) == names


def test_a_value_depends_on_its_seed_and_its_name_alone():
    table = read_toml(DEFAULT)
    first = sampled(table, 5)
    again = sampled(table, 5)
    other = sampled(table, 6)
    assert first == again and first.values != other.values
    del table["object"]["size_percent"], table["gas"]
    part = sampled(table, 5).values
    assert part and all(first.values[name] == value for name, value in part.items())
    assert first.values["left.stiffness_percent"] != first.values["right.stiffness_percent"]


@pytest.mark.parametrize(
    ("spread", "law"),
    [
        (Spread(-5.0, 5.0), ("uniform", (-5, 10))),
        (Spread(mean=1.0, sd=2.0), (truncnorm(-3, 3, 1, 2).cdf, ())),
    ],
)
def test_distributions(spread, law):
    """2000 evenly spaced fractions give the stated distribution: Kolmogorov's distance is rounding
    alone."""
    values = [spread.at(fraction) for fraction in (np.arange(2000) + 0.5) / 2000]
    assert kstest(values, law[0], law[1]).statistic < 1e-3
    one_of = [
        Spread(choices=(0.0, 0.0, 1.0)).at(fraction) for fraction in (np.arange(300) + 0.5) / 300
    ]
    assert sum(one_of) == 100


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        (
            "object",
            "size_percent",
            [5, -5],
            r"object.size_percent: \[5, -5\] is not an ascending range",
        ),
        (
            "object",
            "size_percent",
            [-5, 300],
            r"object.size_percent\[1\]: 300 is outside -50 to 100",
        ),
        (
            "object",
            "size",
            [-5, 5],
            "object.size: unknown field, wrong unit\\? write it as 'size_percent'",
        ),
        ("sensor", "blur_mm", 0.1, "sensor.blur_mm: unknown field, wrong unit"),
        (
            "sensor",
            "fx_percent",
            {"mean": 40, "sd": 5},
            "sensor.fx_percent: reaches from 25 to 55, outside -50 to 50",
        ),
        ("sensor", "fx_percent", {"mean": 0}, "sensor.fx_percent.sd: missing field"),
        ("sensor", "fx_percent", {"mean": 0, "sigma": 1}, "missing field"),
        ("gas", "leak_mL_s_kPa", {"choices": []}, "gas.leak_mL_s_kPa: no choices"),
        ("rig", "delay_ms", "slow", "rig.delay_ms: 'slow' is not a number"),
        ("rigs", "delay_ms", 1, "rigs: unknown section, did you mean 'rig'"),
    ],
)
def test_a_wrong_field_is_one_line_that_names_it(section, key, value, message):
    with pytest.raises(InputError, match=message) as caught:
        read({section: {key: value}})
    assert str(caught.value).startswith("my.toml") and "\n" not in str(caught.value)


def test_a_wrong_name_lists_the_choices():
    with pytest.raises(
        InputError,
        match=r"unknown variation 'defalt' \(valid: " r"camera, default, harsh, none, FILE.toml\)",
    ):
        load_variation("defalt")
    assert not load_variation(NONE).sample(1, fingers=("left",), markers=81).values


def test_units_and_fingers():
    world = sampled(
        {
            "object": {"mass_percent": 20, "place_mm": [2, 2], "yaw_deg": 90},
            "rig": {"delay_ms": 10, "backlash_mm": 0.2},
            "sensor": {"camera_tilt_deg": 1, "missing_markers": 2},
            "gas": {"leak_mL_s_kPa": 0.01, "temperature_drift_K_min": 6},
        }
    )
    assert world.object == ObjectChange(
        mass=0.2, place=(0.002, 0.002), yaw=pytest.approx(np.pi / 2)
    )
    assert (world.rig.delay, world.rig.backlash) == (pytest.approx(0.01), pytest.approx(2e-4))
    left = world.as_built_sensor("left")
    right = world.as_built_sensor("right")
    np.testing.assert_allclose(left.tilt, np.pi / 180)
    assert left.leak == pytest.approx(1e-11) and left.warming == pytest.approx(0.1)
    assert len(left.missing) == len(right.missing) == 2 and left.missing != right.missing
    assert world.values["left.missing_markers"] == list(left.missing)


@pytest.mark.parametrize("name", ["egg", "strawberry", "tofu"])
def test_a_changed_object_has_the_right_mass_and_size(name):
    """Length by s, mass by s^3 (1 + m), inertia by s^2 more; springs and moduli by their own
    fraction."""
    path = load_object(name).path
    spec = mujoco.MjSpec.from_file(str(path))
    before = spec.compile()
    change(spec, ObjectChange(size=0.1, mass=0.2, friction=-0.5, stiffness=0.3))
    after = spec.compile()
    np.testing.assert_allclose(after.body_mass, 1.1**3 * 1.2 * before.body_mass, rtol=1e-9)
    np.testing.assert_allclose(
        after.body_inertia, 1.1**5 * 1.2 * before.body_inertia, rtol=1e-9, atol=1e-18
    )
    np.testing.assert_allclose(after.geom_rbound, 1.1 * before.geom_rbound)
    np.testing.assert_allclose(after.body_pos, 1.1 * before.body_pos, atol=1e-15)
    np.testing.assert_allclose(after.geom_friction[:, 0], 0.5 * before.geom_friction[:, 0])
    np.testing.assert_allclose(after.jnt_stiffness, 1.3 * before.jnt_stiffness)
    shapes = []
    for model in (before, after):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        shapes.append(data.flexvert_xpos.copy())
    np.testing.assert_allclose(shapes[1], 1.1 * shapes[0], atol=1e-12)


def test_samples_change_the_world_and_not_the_sensing():
    world = sample_world("default", 3, DESIGN, FILE)
    rig = build_sim_rig(Scenario(sensor=DESIGN, seed=3, effects="-shadows"), sampled=world)
    try:
        for finger, sensor in zip(rig.fingers, rig.scene.sensors, strict=True):
            assert (
                finger.design.membrane == DESIGN.membrane and finger.design.camera == DESIGN.camera
            )
            fraction = 1 + world.as_built_sensor(finger.name).stiffness_fraction
            assert sensor.design.membrane.young == pytest.approx(fraction * DESIGN.membrane.young)
        stands = load_object("egg").break_force * (1 + world.object.breaking)
        assert (
            rig.scene.object.break_force == pytest.approx(stands) and rig.randomized == world.values
        )
        assert rig.limits.speed == FILE.gripper.speed != rig.scene.rig.gripper.speed
        np.testing.assert_allclose(
            rig.scene.data.body("object/object").xpos[:2], world.object.place, atol=1e-9
        )
    finally:
        rig.close()


def test_missing_markers_are_not_detected():
    own = AsBuiltSensor("left", missing=(0, 40), light_fraction=0.1)
    true = true_design(DESIGN, own)
    flat = true.markers.p_SM, np.tile([0.0, 0.0, -1.0], (81, 1))
    renderer = Renderer(true, radius=marker_radii(true, own))
    observed = detect(renderer.render(*flat)).center_px
    assert (
        len(observed) == 79
        and renderer.render(*flat).pixels.mean() > Renderer(DESIGN).render(*flat).pixels.mean()
    )


def test_a_sealed_rigid_chamber_warms_as_the_gas_law_states():
    """p / T is constant at a constant volume: 3 K of 293.15 in 30 s, in steps, with and without an
    exchange of heat."""
    for chamber in (Chamber(0.02), Chamber(0.02, polytropic_exponent=1.4, heat_exchange=1.0)):
        gas = ChamberGas(chamber)
        gas.open(1000.0)
        gas.advance(2e-5, 0.0)
        gas.close()
        gas.warm(0.1)
        assert not gas.is_still
        for _ in range(300):
            gas.advance(2e-5, 0.1)
        assert gas.gauge_pressure + chamber.ambient == pytest.approx(
            (chamber.ambient + 1000) * 296.15 / 293.15, rel=1e-9
        )


class FakeWorld:
    """Gripper that reaches every goal immediately."""

    max_opening = 0.1
    opening_speed = 0.0
    grip_force = 1.0
    lift_height = 0.0

    def __init__(self):
        self.opening = 0.05
        self.time = 0.0
        self.calls = []
        jaws = SimpleNamespace(opening=(0.0, 0.1), force_max=8.0, backlash=0.0)
        self.rig = SimpleNamespace(gripper=jaws, lift=SimpleNamespace(travel=0.1))

    def after_each_step_batch(self, call, due):
        """Store `call` for each step: each batch of steps is shorter than the time to any event."""
        assert due() > self.time - 1e-9
        self.calls.append(call)

    def set_finger_target(self, opening, force):
        self.opening = opening

    def set_lift_target(self, height): ...

    def step(self, seconds):
        self.time += seconds
        for call in self.calls:
            call()


def gripper(change):
    world = FakeWorld()
    gripper_rig = SimGripper(world, SimpleNamespace(defer=lambda action: action()), change)  # type: ignore[arg-type]
    return (
        world,
        lambda opening: gripper_rig.command(
            Command(opening=opening, force_limit=1.0, lift_height=0.0)
        ),
        gripper_rig,
    )


def test_gear_backlash_is_simulated():
    world, go, gripper_rig = gripper(RigChange(backlash=4e-4))
    go(0.04)
    # half the backlash behind the closed motor
    assert world.opening == pytest.approx(0.0402)
    assert gripper_rig.state().opening == pytest.approx(0.04)
    go(0.0401)
    assert world.opening == pytest.approx(0.0402)  # within the backlash
    go(0.0406)
    assert world.opening == pytest.approx(0.0404)


def test_delayed_commands_keep_their_order():
    world, go, _ = gripper(RigChange(delay=0.010, jitter=0.020))
    openings = []
    for k in range(200):
        go(0.05 - 1e-4 * k)
        before = world.opening
        world.step(0.005)
        openings.append(world.opening)
        assert world.opening <= before
    late = (
        np.array(
            [
                np.searchsorted(-np.array(openings), -(0.05 - 1e-4 * k) - 1e-9) - k
                for k in range(1, 150)
            ]
        )
        * 5e-3
    )
    # after the step in which it was sent
    assert late.min() >= 0.010 - 0.005 and late.max() <= 0.035 and np.ptp(late) > 0.01


def test_current_noise_affects_only_the_reported_current():
    world, _, gripper_rig = gripper(RigChange(force_noise=0.1))
    forces = [gripper_rig.state().effort for _ in range(400)]
    # 3 sd of the sd of 400
    assert np.std(forces) == pytest.approx(0.1, rel=0.11) and world.grip_force == 1.0


def test_an_object_keeps_the_height_at_which_it_is_grasped():
    egg = load_object("egg")
    large = egg.changed(ObjectChange(size=0.05, breaking=0.2))
    assert large.grasp_height == egg.grasp_height and large.break_force == pytest.approx(3.0)
    assert large.width == pytest.approx(1.05 * egg.width)
    kept = {name: getattr(egg, name) for name in ("changes", "break_force", "mass", "width")}
    assert replace(large, **kept) == egg
