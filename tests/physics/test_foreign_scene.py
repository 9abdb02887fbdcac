"""Tests of a sensor in a third-party scene with its own options, contact bits, keyframes and
files."""

import mujoco
import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.sim.attach import attach_membrane, configure_options

FOREIGN_SCENE = """<mujoco><option noslip_iterations="20" {option}><flag {flag}/></option>{size}
<worldbody>
 <body name="arm" pos="0 0 0.3"><joint name="first" type="slide" axis="1 0 0" damping="1"/><geom size="0.02" mass="0.5"/>
  <body name="finger" pos="0 0 0.1" gravcomp="1"><geom size="0.02" mass="0.1"/><site name="tip" pos="0 0 0.03"/></body></body>
 <body name="ball" pos="{place}"><joint name="last" type="slide" axis="0 0 1"/>
  <geom size="0.015" mass="0.02" contype="{bits}" conaffinity="{bits}"/></body>
</worldbody>
<keyframe><key name="home" qpos="0.1 0.2" qvel="1 2"/></keyframe></mujoco>"""
# the latter 3 mm over the flat membrane
BESIDE = "1 0 0.5"
ABOVE = "0 0 0.448"


def foreign_scene(*, place=BESIDE, bits=1, option="", flag="contact='enable'", size=""):
    spec = mujoco.MjSpec.from_string(
        FOREIGN_SCENE.format(place=place, bits=bits, option=option, flag=flag, size=size)
    )
    changed = configure_options(spec)
    return spec, changed


def settle(model, data, sensor, count=150):
    for _ in range(count):
        sensor.update()
        mujoco.mj_step(model, data)


def bound(spec, attachment):
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data, attachment.bind(model, data)


def bulge(sensor):
    return sensor.height_at(0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        (
            {},
            [
                "integrator",
                "solver",
                "noslip_iterations: 20 -> 0",
                "timestep: 0.002 s -> 0.004 s",
                "autoreset",
            ],
        ),
        (
            {"option": 'solver="CG" integrator="implicitfast" jacobian="dense"'},
            ["implicitfast -> discrete", "jacobian: dense"],
        ),
        ({"flag": 'contact="disable" spring="disable"'}, ["flag contact", "flag spring"]),
        ({"flag": 'override="enable"'}, ["flag override"]),
        ({"size": '<size memory="100K"/>'}, ["size.memory: 102400"]),
    ],
)
def test_recommended_options_list_their_changes_and_then_support_a_sensor(changes, reported):
    spec, changed = foreign_scene(**changes)
    assert all(any(words in line for line in changed) for words in reported)
    assert configure_options(spec) == ()
    attach_membrane(spec, "dense", site="tip")


def test_an_objects_contact_bits_do_not_matter():
    depths = []
    for bits in (1, 2, 1 << 20):
        spec, _ = foreign_scene(place=ABOVE, bits=bits)
        model, data, sensor = bound(spec, attach_membrane(spec, "dense", site="tip"))
        sensor.open_valve()
        settle(model, data, sensor)
        assert data.body("ball").xpos[2] > 0.443  # the object lies on the membrane
        depths.append(bulge(sensor))
    # the same contacts for any contact bits
    np.testing.assert_allclose(depths, depths[0], rtol=1e-6)


def test_a_site_that_cannot_carry_a_sensor_is_refused():
    spec = mujoco.MjSpec.from_string("""<mujoco><worldbody><body name="ghost" mocap="true"><body><site name="tip"/></body></body>
        </worldbody></mujoco>""")
    configure_options(spec)
    with pytest.raises(InputError, match="site: 'tip' is on the mocap body 'ghost'"):
        attach_membrane(spec, "dense", site="tip")
    with pytest.raises(InputError, match="site"):
        attach_membrane(spec, "dense", site=foreign_scene()[0].site("tip"))  # of another scene


def test_keyframes_keep_their_joints():
    spec, _ = foreign_scene()
    attach_membrane(spec, "dense", site="tip")
    model = spec.compile()
    places = [
        (model.joint(name).qposadr[0], model.joint(name).dofadr[0]) for name in ("first", "last")
    ]
    assert [model.key_qpos[0, qpos] for qpos, _ in places] == [0.1, 0.2]
    assert [model.key_qvel[0, dof] for _, dof in places] == [1.0, 2.0]


def test_a_sensor_on_a_weightless_robot_is_weightless():
    spec, _ = foreign_scene()
    attach_membrane(spec, "dense", site="tip", prefix="it/")
    model = spec.compile()
    assert model.body_gravcomp[model.body("it/sensor").id] == 1.0


def test_a_saved_scene_can_be_loaded_and_bound_again():
    spec, _ = foreign_scene()
    attachment = attach_membrane(spec, "dense", site="tip")
    model, data, sensor = bound(spec, attachment)
    again = bound(mujoco.MjSpec.from_string(spec.to_xml()), attachment)
    for run in ((model, data, sensor), again):
        run[2].open_valve()
        settle(*run)
    # XML keeps six digits of positions
    np.testing.assert_allclose(bulge(again[2]), bulge(sensor), rtol=1e-4)


def test_binding_again_while_a_sensor_sleeps_starts_from_an_awake_model():
    spec, _ = foreign_scene()
    attachment = attach_membrane(spec, "dense", site="tip")
    model, data, sensor = bound(spec, attachment)
    names = (
        "geom_gap",
        "geom_conaffinity",
        "body_margin",
        "body_conaffinity",
        "flex_conaffinity",
        "flex_rigid",
        "jnt_stiffness",
        "qpos_spring",
        "tendon_num",
    )
    awake = [np.copy(getattr(model, name)) for name in names]
    settle(model, data, sensor)
    assert sensor.is_asleep
    sensor = attachment.bind(model, data)
    for name, before in zip(names, awake, strict=True):
        np.testing.assert_array_equal(getattr(model, name), before, err_msg=name)
    sensor.open_valve()
    settle(model, data, sensor)
    fresh = bound(spec, attachment)
    fresh[2].open_valve()
    settle(*fresh)
    np.testing.assert_allclose(bulge(sensor), bulge(fresh[2]), rtol=1e-6)  # both have settled
