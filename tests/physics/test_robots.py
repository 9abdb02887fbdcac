"""Tests of simulated robots from rig files: start position, motion of jaws and arm, statics of the
held object, and findings of `mjtactile doctor` about faulty robots."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.rig.file import load_sim_rig
from mjtactile.sim import ground_truth
from mjtactile.sim.doctor import examine_simulated
from mjtactile.sim.scenes import mjcf_trial
from mjtactile.sim.scenes.grasp_world import GraspWorld

MESH = (11, 9)  # neither kinematics nor balance depend on the mesh: use a cheap mesh
RIGS = ("sim", "sim_arm", "sim_three_finger")
ONE_AND_THE_REST = ["sim", *(pytest.param(name, marks=pytest.mark.slow) for name in RIGS[1:])]
GRAVITY = 9.81


@pytest.fixture(autouse=True)
def no_trial(monkeypatch):
    """Read models without a trial in a child process, which a number as large as a stiffness
    requires."""
    monkeypatch.setattr(mjcf_trial, "refusal", lambda *_: "")


LIFT = "travel_mm = 150.0"


def variant(folder, name, model=(), rig=()):
    """Return a copy of a shipped rig with texts of its model and its rig file replaced.

    It lifts by 50 mm and moves at 100 mm/s, which shortens the motion.
    """
    text = resources.find(name, "models/rigs", ".toml").read_text()
    xml = (
        resources.folder("models/grippers") / text.split("../grippers/")[1].split('"')[0]
    ).read_text()
    text = text.replace(text.split('model = "')[1].split('"')[0], "model.xml")
    for old, new in model:
        assert old in xml, old
        xml = xml.replace(old, new)
    for old, new in rig:
        assert old in text, old
        text = text.replace(old, new)
    text = text.replace(LIFT, "travel_mm = 50.0")
    text = text.replace("speed_max_mm_s = 50.0", "speed_max_mm_s = 100.0")
    (folder / "model.xml").write_text(xml)
    (folder / "rig.toml").write_text(text)
    return load_sim_rig(folder / "rig.toml")


def make(rig, grasped="egg", **settings):
    return GraspWorld("paper16", grasped, rig=rig, mesh=MESH, **settings)


def tips(world):
    """Return fingertips (n, 3) m and rotations (n, 3, 3)."""
    bodies = [sensor.body_id for sensor in world.sensors]
    return world.data.xpos[bodies].copy(), world.data.xmat[bodies].reshape(-1, 3, 3).copy()


@pytest.mark.parametrize("name", RIGS)
def test_a_robot_starts_open_at_the_grasp_height_of_the_object(name):
    world = make(name)
    p_WS, R_WS = tips(world)
    centre = p_WS.mean(axis=0)
    if name != "sim_three_finger":  # whose tips descend while they close, see below
        assert centre[2] == pytest.approx(world.object.grasp_height, abs=1e-6)
    assert ground_truth.object_position(world)[:2] == pytest.approx(centre[:2], abs=1e-6)
    opening = 2 * np.mean(np.sum((centre - p_WS) * R_WS[:, :, 2], axis=1))
    assert opening == pytest.approx(world.opening, abs=1e-6) == pytest.approx(0.08, abs=1e-6)
    world.step(25)
    assert (
        abs(world.lift_height) < 1e-5 and abs(world.opening - 0.08) < 1e-5
    )  # the robot is at rest


@pytest.mark.parametrize("name", RIGS)
def test_the_transmission_laws_predict_the_fingertip_positions(name):
    world = make(name)
    for opening in (0.03, 0.06, 0.09):
        world.place_gripper(opening, 0.02)
        mujoco.mj_kinematics(world.model, world.data)
        p_WS, R_WS = tips(world)
        observed = 2 * np.mean(np.sum((p_WS.mean(axis=0) - p_WS) * R_WS[:, :, 2], axis=1))
        assert observed == pytest.approx(opening, abs=1e-6)
        assert world.lift_height == pytest.approx(0.02, abs=1e-6)


def test_an_arm_lifts_straight_up_and_does_not_turn_the_gripper():
    world = make("sim_arm")
    (start, R_start), path = tips(world), []
    world.set_lift_target(0.15)
    for _ in range(30):
        world.step(30)
        path.append(tips(world))
    moved = np.array([p_WS - start for p_WS, _ in path]).mean(axis=1)
    assert moved[-1, 2] == pytest.approx(0.15, abs=2e-4)
    # servos lag by some milliseconds, the joints not equally
    assert np.abs(moved[:, :2]).max() < 1e-3
    turned = [
        np.arccos(np.clip((np.einsum("fij,fij->f", R_start, R_WS) - 1) / 2, -1, 1)).max()
        for _, R_WS in path
    ]
    assert max(turned) < 5e-3  # rad
    assert abs(np.arccos(np.clip((np.trace(R_start[0].T @ path[-1][1][0]) - 1) / 2, -1, 1))) < 1e-3


def test_an_arm_with_gravity_compensation_does_not_sag(tmp_path):
    heavy = make(variant(tmp_path, "sim_arm", model=[(' gravcomp="1"', "")]))
    heavy.step(100)
    # 10 kg on servos of 4000 N m/rad would sink by 2 mm; the goals are ahead by that
    assert abs(heavy.lift_height) < 1e-4


@pytest.mark.parametrize("name", ["sim_arm", "sim_three_finger"])
def test_statics_of_a_held_object(name):
    world = make(name, opening=0.045, timestep=1 / 240)
    for sensor in range(len(world.sensors)):
        world.sensors[sensor].open_valve()
    world.step(50)
    for sensor in range(len(world.sensors)):
        world.sensors[sensor].close_valve()
    world.set_finger_target(0.02, 0.5)
    world.step(240)
    world.set_lift_target(0.02)
    world.step(240)
    contact = np.zeros((len(world.sensors), 3))
    servo = 0.0
    for _ in range(30):
        world.step()
        contact += [ground_truth.contact_force(world, i) / 30 for i in range(len(world.sensors))]
        servo += world.grip_force / 30
    # virtual work: each of n fingers pushes with 2/n of the actuator's force over dx/da; viscous
    # friction vanishes at equilibrium. On a parallel linkage the fingertips also rise by tan(a) of
    # their closing distance, with their part of the weight
    rise = np.tan(np.arcsin((world.opening - 0.05) / 0.12)) if name == "sim_three_finger" else 0.0
    weight = world.object.mass * GRAVITY
    assert servo == pytest.approx(0.5, rel=1e-3)
    # the solver's tolerance, creep
    assert -contact[:, 2] == pytest.approx(servo + rise * weight / len(contact), rel=3e-3)
    _, R_WS = tips(world)
    on_object = -np.einsum("fij,fj->i", R_WS, contact)
    # 3 %: the object still settles by micrometres
    assert on_object[2] == pytest.approx(weight, rel=0.03)
    assert np.abs(on_object[:2]).max() < 0.01  # force in N; no lateral push
    assert ground_truth.object_position(world)[2] > 0.0315 + 0.019


def test_actuators_with_individual_gains_and_in_pairs(tmp_path):
    pair = (
        '<general name="{0}" joint="{0}_jaw" biastype="affine" gainprm="40" biasprm="3 -4000 '
        '-60" ctrlrange="0 255"/>'
    )
    rig = variant(
        tmp_path,
        "sim_arm",
        model=[
            (
                '<position name="grip" joint="left_jaw" kp="8000" kv="120" forcerange="-20 20"/>',
                pair.format("left") + pair.format("right"),
            )
        ],
        rig=[
            ('name = "grip"', 'name = "left"'),
            (
                "mm_per_mm = 2.0",
                'mm_per_mm = 1.0\n\n[[gripper.actuator]]\nname = "right"\ntransmission = '
                '"slide"\nmm_per_mm = 1.0',
            ),
        ],
    )
    world = make(rig)
    world.set_finger_target(0.05)
    world.step(250)
    assert world.opening == pytest.approx(0.05, abs=1e-5)
    p_WS, _ = tips(world)
    assert np.linalg.norm(p_WS[1] - p_WS[0]) == pytest.approx(0.05, abs=1e-5)


def test_a_rig_without_a_lift_holds_its_object(tmp_path):
    text = 'kind = "actuator"\nactuator = "lift"'
    world = make(variant(tmp_path, "sim", rig=[(text, 'kind = "none"')]))
    world.set_lift_target(0.04)
    world.step(250)
    # the requested height, as a real rig without a lift reports it
    assert world.lift_height == pytest.approx(0.04)
    assert tips(world)[0][:, 2] == pytest.approx(world.object.grasp_height, abs=1e-4)


def test_the_users_defaults_do_not_affect_table_and_object():
    world = make("sim_arm", "vial")  # its MJCF disables contact of geoms
    world.step(100)
    assert ground_truth.object_position(world)[2] == pytest.approx(0.025, abs=5e-4)


def test_a_base_that_is_turned_in_a_frame_is_raised_straight_up(tmp_path):
    turned = [
        (
            '<body name="hand" gravcomp="1">',
            '<frame pos="0.1 0.2 -0.3" euler="1.5708 0 0"><frame euler="-1.5708 0 0"><body '
            'name="hand" gravcomp="1">',
        ),
        ("</worldbody>", "</frame></frame></worldbody>"),
    ]
    world = make(variant(tmp_path, "sim", model=turned))
    assert tips(world)[0].mean(axis=0) == pytest.approx(
        [0.1, 0.2, world.object.grasp_height], abs=1e-6
    )
    assert ground_truth.object_position(world)[:2] == pytest.approx([0.1, 0.2], abs=1e-6)


# -- errors are reported -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "model", "rig", "message"),
    [
        (
            "sim",
            [],
            [('"right_fingertip"', '"right_tip"')],
            r"finger\[1\]\.site: model\.xml has no site " r"'right_tip' \(valid: left_",
        ),
        (
            "sim",
            [],
            [('name = "jaw"', 'name = "jaws"')],
            r"actuator\[0\]\.name: model\.xml has no " r"actuator 'jaws' \(valid: jaw, l",
        ),
        (
            "sim",
            [],
            [('actuator = "lift"', 'actuator = "up"')],
            r"lift\.actuator: model\.xml has no " r"actuator 'up'",
        ),
        (
            "sim_three_finger",
            [],
            [('body = "carrier"', 'body = "hand"')],
            r"no mocap body 'hand' \(valid: carrier\)",
        ),
        (
            "sim_arm",
            [],
            [('keyframe = "home"', 'keyframe = "rest"')],
            r"sim\.keyframe: .* \(valid: home\)",
        ),
        ("sim", [], [('"right_fingertip"', '"left_fingertip"')], r"two fingers have the same site"),
        ("sim", [("<mujoco", "<mujocko")], [], r"model\.xml: not valid MJCF"),
        (
            "sim",
            [
                (
                    '<position name="jaw" tendon="opening" kp="2000" kv="30" forcerange="-8 8"/>',
                    '<motor name="jaw" tendon="opening"/>',
                )
            ],
            [],
            r"actuator 'jaw': is not a position " r"actuator",
        ),
        (
            "sim",
            [],
            [("mm_per_mm = 1.0", "mm_per_mm = -1.0")],
            r"do not open to 80 mm \(check the sign of the transmission\)",
        ),
        (
            "sim_arm",
            [],
            [(LIFT, "travel_mm = 900.0")],
            r"lift\.travel_mm: the arm does not reach " r".* above its start",
        ),
        (
            "sim_arm",
            [],
            [('kind = "arm"', 'kind = "arm"\nactuators = ["turn", "shoulder"]')],
            r"the arm does not reach the table",
        ),
    ],
)
def test_an_invalid_robot_is_refused_in_one_line(tmp_path, name, model, rig, message):
    with pytest.raises(InputError, match=message) as caught:
        make(variant(tmp_path, name, model, rig))
    assert "\n" not in str(caught.value)


def bad(findings):
    return [
        f"{finding.level} {finding.subject}: {finding.text}"
        for finding in findings
        if finding.level != "ok"
    ]


@pytest.mark.parametrize("name", ONE_AND_THE_REST)
def test_the_doctor_reports_no_fault_of_shipped_robots(name):
    assert bad(examine_simulated(load_sim_rig(name))) == []


@pytest.mark.parametrize(
    ("name", "model", "rig", "found"),
    [
        (
            "sim",
            [],
            [('"right_fingertip"', '"right_tip"'), ('name = "jaw"', 'name = "jaws"')],
            [
                "bad finger[1].site: model.xml has no site 'right_tip'",
                "bad gripper.actuator[0].name",
            ],
        ),
        (
            "sim",
            [
                (
                    'name="left_fingertip" xyaxes="0 1 0 0 0 1"',
                    'name="left_fingertip" xyaxes="0 -1 0 0 0 1"',
                )
            ],
            [],
            ["bad finger left: z of site 'left_fingertip' points 180 degrees away"],
        ),
        (
            "sim",
            [
                (
                    'name="left_fingertip" xyaxes="0 1 0 0 0 1"',
                    'name="left_fingertip" xyaxes="0 1 0 -0.5 0 0.866"',
                )
            ],
            [],
            [
                "warn finger left: z of site 'left_fingertip' misses the center of the fingertips "
                "by 30 degrees"
            ],
        ),
        (
            "sim",
            [],
            [("mm_per_mm = 1.0", "mm_per_mm = -1.0\njaw_offset_mm = 120")],
            [
                "bad jaws: move in the wrong direction: on a command to close, the fingertips "
                "move from 0.0 to 120.0 mm"
            ],
        ),
        (
            "sim",
            [],
            [("mm_per_mm = 1.0", "mm_per_mm = 1.1")],
            ["warn jaws: do not follow the transmission"],
        ),
        (
            "sim",
            [
                (
                    'pos="0 0 0.085" size="0.1 0.02 0.01" contype="0"',
                    'pos="0 0 0.02" size="0.1 0.02 0.01" contype="1"',
                )
            ],
            [],
            ["bad finger left: its sensor touches 'palm'"],
        ),
        (
            "sim",
            [('forcerange="-8 8"', 'forcerange="-0.5 0.5"')],
            [],
            ["bad force: the actuators close each finger with at most 0.5 N: too little"],
        ),
        (
            "sim_arm",
            [('forcerange="-20 20"', 'forcerange="-10 10"')],
            [],
            ["warn force: the actuators close each finger with at most 5 N, force_max_N says 8"],
        ),
        ("sim_arm", [], [(LIFT, "travel_mm = 900.0")], ["bad lift.travel_mm"]),
        (
            "sim",
            [('xyaxes="0 -1 0 0 0 1"', 'xyaxes="0 1 0 0 0 -1"')],
            [],
            ["warn frames: y of the sites 'left_fingertip' and 'right_fingertip' differs by 180"],
        ),
    ],
)
def test_the_doctor_reports_each_fault(tmp_path, name, model, rig, found):
    findings = bad(examine_simulated(variant(tmp_path, name, model, rig)))
    assert [any(text.startswith(words) for text in findings) for words in found] == [True] * len(
        found
    ), findings


def test_a_finger_has_the_sensor_that_the_file_names():
    rig = load_sim_rig("sim")
    left, right = rig.fingers
    world = make(replace(rig, fingers=(left, replace(right, sensor="dense"))))
    assert [sensor.design.name for sensor in world.sensors] == ["paper16", "dense"]


def test_hinged_tips_meet_the_object_at_its_height():
    """Tips on bars of 60 mm start higher than the object by the amount that they descend while
    closing.

    They descend by 60 mm (cos a - cos b) for the angles of the crank at both openings: 1.2 mm here.
    Without this the egg was grasped too low by as much.
    """
    wide, grip = (math.asin((opening - 0.05) / 0.12) for opening in (0.08, 0.032))
    world = GraspWorld("paper16", "egg", rig="sim_three_finger")
    assert world.object.width == pytest.approx(0.032)
    tips = [sensor.body_id for sensor in world.sensors]
    start = world.data.xpos[tips].mean(axis=0)
    down = 0.06 * (math.cos(grip) - math.cos(wide))
    assert start[2] - world.object.grasp_height == pytest.approx(down, abs=1e-5)
    world.place_gripper(0.032, 0.0)
    mujoco.mj_forward(world.model, world.data)
    center = world.data.xpos[tips].mean(axis=0)
    egg = ground_truth.object_position(world)
    assert center[2] == pytest.approx(world.object.grasp_height, abs=1e-5)
    np.testing.assert_allclose(center[:2], egg[:2], atol=1e-6)


# -- forces that the actuators can give ------------------------------------------------------

SERVO = 'kp="2000" kv="30" forcerange="-8 8"'
JAW = 'damping="2" armature'
ACTUATORS = {
    "soft": [(SERVO, 'kp="50" kv="30"')],
    "control range": [(SERVO, 'kp="200" kv="30" ctrlrange="0.02 0.12"')],
    "springs": [
        (SERVO, 'kp="200" kv="30"'),
        (JAW, 'damping="2" stiffness="30" springref="0.06" armature'),
    ],
    "joint limits": [
        (SERVO, 'kp="2000" kv="30"'),
        (JAW, 'damping="2" actuatorfrcrange="-1.5 1.5" armature'),
    ],
}


@pytest.mark.parametrize("model", ACTUATORS.values(), ids=ACTUATORS.keys())
def test_the_available_force_is_that_of_the_closed_jaws(tmp_path, model):
    """Jaws commanded to close fully load the membranes with the force that statics predicts: gain
    times the distance to the goal, within all ranges, less the springs of the mechanism."""
    world = make(variant(tmp_path, "sim", model=model), "block", opening=0.045, timestep=1 / 240)
    world.set_finger_target(0.0, 8.0)
    world.step(360)
    forces = []
    for _ in range(10):
        world.step(5)
        forces.append([-ground_truth.contact_force(world, finger)[2] for finger in (0, 1)])
    # the requirement; at rest the two agree within 1 %
    assert np.mean(forces, axis=0) == pytest.approx(
        world.grip_force_available(world.opening), rel=0.05
    )


def test_the_doctor_reports_the_force_of_a_soft_servo_at_two_widths(tmp_path):
    """A tendon actuator of 50 N/m closes with 50 N/m times the opening: 1.2 N at 24 mm."""
    rig = variant(tmp_path, "sim", model=ACTUATORS["soft"])
    assert (
        "warn force: the actuators close each finger with at most 1.2 N at 24 mm and 3.6 N at "
        "72 mm, force_max_N says 8"
    ) in bad(examine_simulated(rig))


def test_a_motor_is_refused_with_its_force(tmp_path):
    servo = f'<position name="jaw" tendon="opening" {SERVO}/>'
    for text, force in (
        ('<motor name="jaw" tendon="opening" ctrlrange="-5 3" gear="2"/>', "-5 to 3 N"),
        ('<velocity name="jaw" tendon="opening" kv="10" ctrlrange="-1 1"/>', "-10 to 10 N"),
        ('<motor name="jaw" tendon="opening"/>', "unlimited force"),
        ('<intvelocity name="jaw" tendon="opening" kp="9" actrange="0 1"/>', "pushes with"),
    ):
        with pytest.raises(InputError, match=f"not a position actuator.*{force}"):
            make(variant(tmp_path, "sim", model=[(servo, text)]))


def test_the_doctor_names_the_pad_in_the_chamber_and_a_remedy(tmp_path):
    pad = '<geom name="pad" type="box" size="0.004 0.01 0.002" pos="-0.006 0 0"/>'
    site = '<site name="left_fingertip"'
    rig = variant(tmp_path, "sim", model=[(site, pad + site)])
    (finding,) = [item for item in examine_simulated(rig) if "rest on 'pad'" in item.text]
    assert (finding.level, finding.subject) == ("warn", "finger left")
    assert "contype and conaffinity of the geom to 0" in finding.remedy


def test_the_doctor_does_not_advise_to_exclude_the_table(tmp_path):
    """Without contacts of the table, objects would fall through it."""
    low = '<geom name="bench" type="box" size="0.2 0.2 0.01" pos="0 0 0.02"/>'
    rig = variant(
        tmp_path,
        "sim",
        model=[("<worldbody>", f"<worldbody>{low}")],
        rig=[("[sim]", "[sim]\ntable = false")],
    )
    touched = [item for item in examine_simulated(rig) if "'bench'" in item.text]
    assert touched
    assert all("raise the sites" in item.remedy for item in touched)
    assert not any("contype" in item.remedy for item in touched)
