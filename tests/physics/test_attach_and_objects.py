"""Tests of input that `attach`, the object loader and the world reject, and of the messages."""

import warnings

import mujoco
import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.objects import add_object, load_object
from mjtactile.sim.scenes.world import World


def scene():
    spec = mujoco.MjSpec()
    configure_options(spec)
    spec.worldbody.add_site(name="mount")
    return spec


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("integrator", mujoco.mjtIntegrator.mjINT_EULER, ["integrator", "Euler", "discrete"]),
        (
            "integrator",
            mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
            ["integrator", "implicitfast", "discrete"],
        ),
        ("solver", mujoco.mjtSolver.mjSOL_NEWTON, ["solver", "Newton", "CG"]),
        ("solver", mujoco.mjtSolver.mjSOL_PGS, ["solver", "PGS", "CG"]),
        ("timestep", 0.02, ["timestep", "0.02", "0.008"]),
        ("timestep", 1e-6, ["timestep", "1e-06", "0.0001"]),
        ("timestep", float("nan"), ["timestep", "nan"]),
        ("jacobian", mujoco.mjtJacobian.mjJAC_DENSE, ["jacobian", "dense", "sparse"]),
        ("noslip_iterations", 3, ["noslip_iterations", "3"]),
        ("gravity", [0.0, 0.0, -9810.0], ["gravity", "9810 m/s2", "in m, not in mm"]),
    ],
)
def test_options_that_cannot_carry_a_membrane_are_refused(option, value, words):
    spec = scene()
    setattr(spec.option, option, value)
    with pytest.raises(InputError) as caught:
        attach_membrane(spec, "paper16", site="mount")
    assert all(word in str(caught.value) for word in words)


def test_default_options_of_a_new_scene_are_refused():
    spec = mujoco.MjSpec()
    spec.worldbody.add_site(name="mount")
    with pytest.raises(InputError, match="integrator"):
        attach_membrane(spec, "paper16", site="mount")


def test_options_changed_after_attaching_are_refused_when_binding():
    spec = scene()
    attachment = attach_membrane(spec, "paper16", site="mount")
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    with pytest.raises((InputError, ValueError), match="integrator"):
        model = spec.compile()
        attachment.bind(model, mujoco.MjData(model))


def test_unknown_site_used_prefix_and_bad_mesh_are_refused():
    spec = scene()
    with pytest.raises(InputError, match=r"nowhere.*mount"):
        attach_membrane(spec, "paper16", site="nowhere")
    with pytest.raises(InputError, match="prefix"):
        attach_membrane(spec, "paper16", site="mount", prefix="")
    with pytest.raises(InputError, match="nx"):
        attach_membrane(spec, "paper16", site="mount", mesh=(3, 11))
    attach_membrane(spec, "paper16", site="mount", prefix="one/")
    with pytest.raises(InputError, match="one/"):
        attach_membrane(spec, "paper16", site="mount", prefix="one/")


def test_binding_to_a_foreign_model_is_refused():
    attachment = attach_membrane(scene(), "paper16", site="mount")
    other = scene().compile()
    with pytest.raises(InputError, match="attached"):
        attachment.bind(other, mujoco.MjData(other))


def test_a_model_keeps_its_pre_stretch_when_bound_again():
    spec = scene()
    attachment = attach_membrane(spec, "paper16", site="mount")
    model = spec.compile()
    attachment.bind(model, mujoco.MjData(model))
    once = model.flexedge_length0.copy()
    attachment.bind(model, mujoco.MjData(model))
    np.testing.assert_array_equal(model.flexedge_length0, once)


OBJECT = """<mujoco><custom>{custom}</custom><worldbody><body name="{body}" pos="0 0 0.03">{joint}
<geom type="sphere" size="0.02" mass="0.01" contype="{contype}"/></body></worldbody></mujoco>"""
GOOD = {
    "custom": '<numeric name="break_force_N" data="2"/><text name="material" data="solid"/>',
    "body": "object",
    "joint": "<freejoint/>",
    "contype": "1",
}


def write(folder, text=None, **changes):
    path = folder / "thing.xml"
    path.write_text(OBJECT.format(**{**GOOD, **changes}) if text is None else text)
    return path


def test_an_object_of_a_user_is_read(tmp_path):
    item = load_object(write(tmp_path))
    assert (item.name, item.break_force, item.material) == ("thing", 2.0, "solid")
    assert item.grasp_height == pytest.approx(0.03)
    assert item.mass == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"text": "<mujoco><worldbody><body"}, ["not valid MJCF"]),
        (
            {"text": "<mujoco><worldbody><nonsense/></worldbody></mujoco>"},
            ["not valid MJCF", "nonsense"],
        ),
        ({"text": ""}, ["not valid MJCF"]),
        ({"body": "thing"}, ["'object'", "thing"]),
        ({"joint": ""}, ["free joint"]),
        ({"joint": '<joint type="slide"/>'}, ["free joint"]),
        ({"custom": '<text name="material" data="solid"/>'}, ["break_force_N"]),
        ({"custom": GOOD["custom"].replace('"2"', '"-1"')}, ["break_force_N", "-1"]),
        ({"custom": GOOD["custom"].replace('"2"', '"0"')}, ["break_force_N", "0"]),
        ({"custom": GOOD["custom"].replace('"2"', '"nan"')}, ["break_force_N"]),
        (
            {"custom": '<numeric name="break_force_N" data="2"/>'},
            ["material", "solid", "soft", "amorphous"],
        ),
        (
            {"custom": GOOD["custom"].replace("solid", "jelly")},
            ["jelly", "solid", "soft", "amorphous"],
        ),
        ({"contype": "0"}, ["contype"]),
        (
            {"custom": '<numeric name="turn_deg" data="8"/>' + GOOD["custom"]},
            ["turn_deg", "is now `rotation_deg`"],
        ),
        (
            {"custom": '<numeric name="break_force_mN" data="8"/>' + GOOD["custom"]},
            ["break_force_mN", "did you mean 'break_force_N'"],
        ),
    ],
)
def test_invalid_objects_are_refused_by_file_and_field(tmp_path, changes, words):
    path = write(tmp_path, **changes)
    with pytest.raises(InputError) as caught:
        load_object(path)
    assert str(path) in str(caught.value)
    assert all(word in str(caught.value) for word in words)
    assert "\n" not in str(caught.value)


def test_an_unknown_object_lists_the_shipped_objects():
    with pytest.raises(InputError, match=r"egg.*strawberry.*vial"):
        load_object("pineapple")


def test_object_too_low_for_the_fingers_is_refused(tmp_path):
    path = write(
        tmp_path, text=OBJECT.format(**GOOD).replace("0 0 0.03", "0 0 0.01").replace("0.02", "0.01")
    )
    with pytest.raises(InputError, match="grasp_height_m"):
        GraspWorld("paper16", path)


@pytest.fixture(scope="module")
def grasp():
    return GraspWorld("paper16", "egg", mesh=(7, 7))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -0.01])
def test_commands_that_are_not_numbers_are_refused(grasp, value):
    with pytest.raises(InputError, match="opening"):
        grasp.set_finger_target(value)
    with pytest.raises(InputError, match="force_limit"):
        grasp.set_finger_target(0.05, value)
    with pytest.raises(InputError, match="lift_height"):
        grasp.set_lift_target(value)
    with pytest.raises(InputError, match="not a finite control"):
        grasp.set_control(0, float("nan"))
    with pytest.raises(InputError, match="supply_gauge"):
        grasp.sensors[0].open_valve(float("nan"))


def test_divergence_is_an_error_with_step_and_reason():
    spec = scene()
    world = World(spec, [attach_membrane(spec, "paper16", site="mount", mesh=(7, 7))])
    world.step(5)
    world.data.qvel[10] = np.nan
    with pytest.raises(SimulationError, match=r"step 6 .*: ") as caught:
        world.step()
    assert caught.value.step == 6
    assert world.time > 0  # no silent reset


def test_membrane_pushed_against_the_glass_is_an_error():
    spec = scene()
    spec.option.gravity = [0, 0, 0]
    ball = spec.worldbody.add_body(name="ball", mocap=True, pos=[0, 0, 0.02])
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.008, 0, 0])
    world = World(spec, [attach_membrane(spec, "paper16", site="mount", mesh=(9, 9))])
    with pytest.raises(SimulationError, match="glass"):
        for height in np.linspace(0.02, -0.02, 400):
            world.data.mocap_pos[0, 2] = height
            world.step()


BOX = """<mujoco><custom><numeric name="break_force_N" data="9"/><text name="material" data="solid"/>
 {custom}</custom><worldbody><body name="object" pos="0 0 0.025"><freejoint/>
 <geom type="box" size="0.025 0.025 0.025" mass="0.03"/></body></worldbody></mujoco>"""
LIMITED = '<numeric name="rotation_deg" data="30"/>'


# A cube has faces every 90 degrees: 100 degrees are 10 from the next one.
@pytest.mark.parametrize(
    ("custom", "degrees", "stated"),
    [("", 100.0, "10 degrees"), ("", 92.0, None), (LIMITED, 30.0, None)],
)
def test_the_rotation_of_a_box_by_the_seed_is_stated(tmp_path, custom, degrees, stated):
    path = tmp_path / "cube.xml"
    path.write_text(BOX.format(custom=custom))
    pose = (0.0, 0.0, np.radians(degrees))
    note = GraspWorld("paper16", path, mesh=(7, 7), object_pose=pose).oblique_faces()
    assert (note is None) == (stated is None)
    if stated is not None:
        assert stated in note
        assert "rotation_deg" in note


def test_options_of_an_objects_file_are_those_of_the_scene(tmp_path, caplog):
    """MuJoCo warned in several lines, at every compilation; the options had no effect."""
    egg = resources.find("egg", "models/objects", ".xml").read_text()
    path = tmp_path / "a.xml"
    path.write_text(
        egg.replace(
            "<worldbody>",
            '<size memory="1M"/><option timestep="1" gravity="0 0 9.81"/><worldbody>',
            1,
        )
    )
    item = load_object(path)
    assert caplog.messages == [f"{path}: <option> gravity, timestep has no effect: the scene's do"]
    scene = mujoco.MjSpec()
    scene.option.timestep = 0.004
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        add_object(scene, item)
        model = scene.compile()
    assert model.opt.timestep == 0.004 and model.opt.gravity[2] == -9.81
