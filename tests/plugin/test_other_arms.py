"""Tests of a second third-party scene: the Franka arm in its kitchen, with joint servos, its own
kinematic tree, and gravity."""

from importlib.util import find_spec
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.sim import ground_truth

KITCHEN = "envs/assets/kitchen_franka/kitchen_assets/kitchen_env_model.xml"
ARM = {
    f"robot:panda0_joint{number}": angle
    for number, angle in enumerate((0.148, -1.768, 1.844, -2.477, 0.26, 0.713, 1.595), 1)
}
FINGERS = ("robot:panda0_finger_joint1", "robot:panda0_finger_joint2")
MASS = 0.05


@pytest.fixture(scope="module")
def held():
    """Provide a ball between the fingertips, half a second after its release into the closed
    grip."""
    found = find_spec("gymnasium_robotics")
    if found is None or found.submodule_search_locations is None:
        pytest.skip("needs the extra `examples`")
    spec = mujoco.MjSpec.from_file(f"{found.submodule_search_locations[0]}/{KITCHEN}")
    mjtactile.configure_options(spec)
    tips = []
    for side, inwards in (("left", -1), ("right", 1)):
        spec.body(f"panda0_{side}finger").add_site(
            name=side, pos=[0, 0.002 * inwards, 0.08], quat=[1, -inwards, 0, 0]
        )
        tips.append(mjtactile.attach(spec, "dense", site=side, prefix=f"{side}/"))
    ball = spec.worldbody.add_body(name="ball")
    ball.add_freejoint(name="ball")
    # their masses are of groups 3-5
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.015, 0, 0], mass=MASS, group=3)
    model = spec.compile()
    data = mujoco.MjData(model)
    for number, (joint, place) in enumerate({**ARM, FINGERS[0]: 0.024, FINGERS[1]: 0.024}.items()):
        data.joint(joint).qpos = data.ctrl[number] = place
    # the fingertips' own boxes stand in the chambers
    with pytest.warns(UserWarning, match="instead of the membrane"):
        fingers = [tip.bind(model, data) for tip in tips]
    mujoco.mj_forward(model, data)
    for number in range(200):
        if number < 110:  # the arm sags slightly; the ball moves with it until held
            data.joint("ball").qpos[:3] = (data.site("left").xpos + data.site("right").xpos) / 2
            data.joint("ball").qvel = 0
        data.ctrl[-2:] = max(0.024 - 0.1 * data.time, 0.0155)
        mjtactile.step(model, data, fingers)
    return SimpleNamespace(
        model=model, data=data, fingers=fingers, sensors=[finger.sensor for finger in fingers]
    )


def test_the_held_ball_is_estimated(held):
    true = [ground_truth.contact_force(held, number) for number in range(2)]
    rotations = [held.data.site(side).xmat.reshape(3, 3) for side in ("left", "right")]
    # statics: the ball's force on both membranes is its weight; it swings by less than 0.1 m/s^2
    np.testing.assert_allclose(
        sum(R @ f for R, f in zip(rotations, true, strict=True)),
        [0, 0, -9.81 * MASS],
        atol=0.1 * MASS,
    )
    for finger, force in zip(held.fingers, true, strict=True):
        np.testing.assert_allclose(finger.touch.traction.wrench[:3], force, atol=0.03)


def test_a_sensor_does_not_touch_the_robot_that_carries_it(held):
    names = [
        [held.model.geom(geom).name for geom in pair if geom >= 0]
        for pair in held.data.contact.geom
    ]
    assert not any("housing" in name for pair in names for name in pair)
