"""Tests that every example runs, is short, and prints correct results."""

import os
import runpy
import shutil
import subprocess
import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mjtactile
from mjtactile.core import resources
from mjtactile.recording.reader import load_recording
from mjtactile.runtime.grasp import run_grasp
from mjtactile.sim import ground_truth
from tests.emulated_host import controller_text
from tests.fake_run import write_fake_recording
from tests.gripper_scenes import TWO_FINGERS

FOLDER = Path(__file__).resolve().parents[2] / "examples"
LONGEST = 95  # lines of at most 100 columns: one screen, docstring included


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short(path):
    assert len(path.read_text().splitlines()) < LONGEST


def run(name, needs="mujoco"):
    """Return the global names of an example after its run."""
    if find_spec(needs) is None:
        pytest.skip(f"the example needs {needs}")
    return SimpleNamespace(**runpy.run_path(str(FOLDER / f"{name}.py")))


def true_forces(example, fingers):
    world: Any = SimpleNamespace(
        model=example.model, data=example.data, sensors=[finger.sensor for finger in fingers]
    )
    return [ground_truth.contact_force(world, number) for number in range(len(fingers))]


def test_touch_in_my_scene(capsys):
    example = run("touch_in_my_scene", "gymnasium_robotics")
    [force] = true_forces(example, [example.finger])
    assert -force[2] > 0.2  # the fingers do press on each other
    assert example.finger.touch.force_normal == pytest.approx(-force[2], abs=0.03)
    assert "estimated: " in capsys.readouterr().out


@pytest.mark.slow
def test_example_turn_an_edge(capsys):
    example = run("turn_an_edge")
    assert example.before.kind == "edge"
    # along its rows a mesh of 21 x 16 vertices bends only there, and an edge may be classified as
    # smooth; its radius is then below 10 mm
    assert example.after.kind == "edge" or example.after.curvatures[0] > 100
    # the mesh of 21 x 16 vertices resolves the edge angle to about two degrees
    assert abs(example.angle) < np.radians(4)
    assert example.before.area_interval[0] < example.before.area < example.before.area_interval[1]
    assert "left" in capsys.readouterr().out


@pytest.mark.slow
def test_arm_follows_touch(capsys):
    example = run("arm_follows_touch", "mink")
    # the wall moves at 3 mm/s or less, the arm at 36 mm/s per N: a lag of 0.08 N
    assert np.isfinite(example.held).all()
    assert np.abs(example.held - example.FORCE_GOAL).max() < 0.16
    assert np.mean(example.held) == pytest.approx(example.FORCE_GOAL, abs=0.08)
    assert "estimated 0." in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # robosuite's own
def test_touch_in_robosuite(capsys):
    example = run("touch_in_robosuite", "robosuite")
    estimated = example.observation["force_normal"]
    true = [-finger.ground_truth_wrench()[2] for finger in example.env.fingers]
    assert np.min(estimated) > 0.8  # the gripper closes until the mean estimate is 1 N
    # an image is up to 33 ms old and the arm moves up: the mean of both fingers changes least
    assert np.mean(estimated) == pytest.approx(np.mean(true), rel=0.1)
    # `Lift` counts 40 mm over the table as lifted; the table is at 0.8 m, the center of the cube at
    # 0.82
    assert example.observation["cube_pos"][2] > 0.86
    assert example.env._check_success()
    assert "estimated" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore")  # dm_control's own
def test_touch_in_dm_control(capsys):
    example = run("touch_in_dm_control", "dm_control")
    # at equilibrium the membrane carries the weight; image noise is 8 mN
    assert example.observation["touch/force_normal"] == pytest.approx(9.81 * 0.05, abs=0.025)
    assert example.observation["touch/force_normal"].shape == (1,)
    assert "estimated 0." in capsys.readouterr().out


def write_model_like_2f85(path):
    """Write a four-bar gripper with the names, directions and command range of a 2F-85."""
    pad = '<body name="{0}_pad" pos="0.0096 0 0.00125" euler="0 0 -90"/></body>\n</body>'
    xml = TWO_FINGERS.replace("<worldbody>", '<worldbody><frame pos="0 0 0.073">')
    xml = xml.replace("</worldbody>", "</frame></worldbody>")
    for side in ("right", "left"):
        site = f'<site name="{side}s" pos="0 0 0.02" zaxis="-1 0 0"/>\n </body></body>'
        assert site in xml
        xml = xml.replace(site, pad.format(side))
    actuator = '<position name="close" joint="rightdriver" kp="100" kv="2"/>'
    assert actuator in xml
    # 255: 0.39 rad
    own = 'biastype="affine" gainprm="-0.152" biasprm="0 -100 -2"'
    path.write_text(xml.replace(actuator, f'<general joint="rightdriver" {own}/>'))
    return str(path)


@pytest.mark.slow(20)
def test_touch_on_hands(tmp_path):
    """Estimates are within 3 %, or two standard deviations of an image; membranes within 5 %."""
    example = run("touch_on_hands")
    hand = partial(example.robotiq, write_model_like_2f85(tmp_path / "2f85.xml"))
    true = []
    for effects in ("auto", "-mesh"):
        force, flags, _ = example.hold(hand, example.BALL, 126, effects)
        np.testing.assert_allclose(force[:, 0], force[:, 1], rtol=0.03, atol=0.02)
        assert not flags
        true.append(force[:, 1])
    assert np.min(true) > 0.5
    np.testing.assert_allclose(true[1], true[0], rtol=0.05)


@pytest.mark.slow(20)
@pytest.mark.filterwarnings("ignore")  # the package's own
def test_touch_on_a_shadow_hand():
    """Thumb and index carry the ball; its weight is 0.49 N."""
    example = run("touch_on_hands", "gymnasium_robotics")
    force, flags, _ = example.hold(example.shadow, example.BALL, 0.9, "-mesh")
    np.testing.assert_allclose(force[:, 0], force[:, 1], rtol=0.03, atol=0.03)
    assert force.min() > 0.3
    assert not flags


def code_lines(name):
    """Return the lines that are neither docstring, import, comment nor empty."""
    text = (FOLDER / f"{name}.py").read_text().split('"""', 2)[2]
    return [
        line
        for line in text.splitlines()
        if line.strip() and not line.lstrip().startswith(("#", "import ", "from "))
    ]


@pytest.mark.parametrize(
    "name, maximum",
    [("touch_in_my_scene", 18), ("touch_in_robosuite", 39), ("touch_in_dm_control", 39)],
)
def test_a_first_script_is_short(name, maximum):
    assert len(code_lines(name)) <= maximum


@pytest.mark.slow(5)  # test_touch_in_my_scene attaches a sensor, too
def test_two_sensors_on_an_arm():
    example = run("two_sensors_on_an_arm", "gymnasium_robotics")
    weight = 9.81 * example.model.body_mass[example.model.body("object0").id]
    # it hangs between the fingers, 30 mm over the table
    assert example.data.body("object0").xpos[2] > 0.46
    forces = true_forces(example, example.fingers)
    # the arm has come to rest, and the fingers carry the egg by shear: x of both sensors is along
    # the finger, which hangs
    assert sum(force[0] for force in forces) == pytest.approx(weight, abs=0.02)
    for finger, force in zip(example.fingers, forces, strict=True):
        np.testing.assert_allclose(finger.touch.traction.wrench[:3], force, atol=0.03)


@pytest.mark.slow(10)
def test_example_firmer_in_the_air(tmp_path):
    """The pressure rises from 0.6 to 2 kPa while an egg is held, and the force remains accurate."""
    scenario = mjtactile.Scenario(
        controller=str(FOLDER / "firmer_in_the_air.py"), effects="-images"
    )
    with mjtactile.Recorder(tmp_path, scenario.header(), frames=0) as recorder:
        result = run_grasp(scenario, [recorder])
    assert result.outcome == "held"
    log = load_recording(tmp_path)
    held = log.columns["phase"] == "hold"
    pressures = log.column("gauge_pressure")[held]
    assert pressures[0] == pytest.approx(600.0, abs=25.0)  # noise of the pressure sensor
    assert pressures[-1] == pytest.approx(2000.0, abs=25.0)
    error = (log.column("force_normal") - log.column("force_normal_true"))[held]
    # no force is unknown; the standard deviation of an image is 0.015 N at 2 kPa
    assert np.abs(error.mean(axis=0)).max() < 0.015
    assert np.abs(error).max() < 0.03


@pytest.mark.slow(6)  # test_replay_a_recording opens a session, too
def test_grasp_from_python(capsys, monkeypatch, tmp_path):
    (tmp_path / "quick.py").write_text(controller_text(hold=0.3))
    quick = mjtactile.load_controller(tmp_path / "quick.py")
    monkeypatch.setattr(mjtactile, "load_controller", lambda _: quick)
    example = run("grasp_from_python")
    assert example.last.phase == "done" and "ended as 'done'" in capsys.readouterr().out
    # its target
    assert np.mean(
        [estimated for phase, estimated, _ in example.seen if phase == "hold"]
    ) == pytest.approx(0.6, abs=0.02)


def test_replay_a_recording(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["replay_a_recording.py"])
    example = run("replay_a_recording")
    assert example.count == len(example.first) > 20 and all(example.same.values())
    assert np.isfinite(example.again.column("force_normal")).all()


def test_read_a_log_with_pandas(monkeypatch, tmp_path):
    cycles = write_fake_recording(tmp_path, count=60)
    monkeypatch.setattr(sys, "argv", ["read_a_log_with_pandas.py", str(tmp_path / "log.jsonl")])
    example = run("read_a_log_with_pandas", "pandas")
    hold = [
        [touch.force_normal for touch in cycle.touch]
        for cycle in cycles
        if cycle.sent.phase == "hold"
    ]
    np.testing.assert_allclose(example.forces["hold"], np.mean(hold, axis=0), atol=1e-3)
    assert list(example.forces.index) == [
        "approach",
        "close",
        "regulate",
        "lift",
        "hold",
        "lower",
        "release",
    ]


@pytest.mark.slow  # tests/contract/test_rigs.py replays a calibrated rig
def test_calibrate_and_use_a_finger(capsys):
    example = run("calibrate_and_use_a_finger")
    left, right = np.nanmax(np.abs(example.forces - example.true[: len(example.forces)]), axis=0)
    # force difference in N: same images, same chain; only decimal rounding in the file remains
    assert left < 1e-9
    assert right > 0.01  # a lens error of 3 % is significant
    assert np.nanmax(example.true) > 0.3 and "left finger calibrated" in capsys.readouterr().out


@pytest.mark.clock(20)
def test_my_camera_class_is_found_by_its_entry_point_and_drives_a_rig(tmp_path):
    """The package contains only the example and its entry point, and is installed into its own
    folder."""
    site = tmp_path / "site"
    work = tmp_path / "work"
    (site / "my_camera-1.0.dist-info").mkdir(parents=True)
    work.mkdir()
    shutil.copy(FOLDER / "my_camera_class.py", site)
    (site / "my_camera-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: my-camera\nVersion: 1.0\n"
    )
    (site / "my_camera-1.0.dist-info" / "entry_points.txt").write_text(
        "[mjtactile.cameras]\nnewest = my_camera_class:NewestFrame\n"
    )
    rig = (
        resources.find("emulated", "models/rigs", ".toml")
        .read_text()
        .replace('backend = "ffmpeg"', 'backend = "newest"')
        .replace("reply_timeout_ms = 20", "reply_timeout_ms = 100")  # this test checks the camera
    )
    (work / "rig.toml").write_text(rig)
    environment = os.environ | {
        "MJTACTILE_TIME_SCALE": "6",  # the rig rejects images older than 0.15 s
        "PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]),
    }
    process = subprocess.run(
        [
            sys.executable,
            "-m",
            "mjtactile",
            "record",
            "--rig",
            "rig.toml",
            "--seconds",
            "1",
            "--sensor",
            "paper16",
            "--out",
            "out",
            "--json",
        ],
        cwd=work,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert process.returncode == 0, process.stderr
    reported = set(np.concatenate(list(load_recording(work / "out").columns["status"])))
    assert "ok" in reported  # markers were detected in the images of the example
    # stale images may occur on a busy computer
    assert all("stale" in status for status in reported - {"ok"})


def test_train_a_policy_reproduces_the_teacher():
    """The fit recovers a linear teacher; an input that never changed gets no weight."""
    example = run("train_a_policy")
    rng = np.random.default_rng(0)
    observed = rng.standard_normal((500, 6)) * [1, 10, 0.1, 1, 1, 0]
    w = rng.standard_normal((3, 6))
    found, offsets = example.fit(observed, observed @ w.T + [0.1, 0.2, 0.3])
    # the ridge parameter of 1e-4 reduces the weights
    np.testing.assert_allclose(found[:, :5], w[:, :5], rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(offsets, [0.1, 0.2, 0.3], atol=2e-3)
    assert not found[:, 5].any()


def test_a_trained_policy_loads(tmp_path, monkeypatch):
    """The file computes the weights' action from 30 inputs of two fingers."""
    example = run("train_a_policy")
    rng = np.random.default_rng(1)
    w = rng.standard_normal((3, 30))

    def record_grasp(_):
        observed = rng.standard_normal((400, 30))
        return observed, observed @ w.T

    monkeypatch.setitem(example.main.__globals__, "record_grasp", record_grasp)
    example.main(str(tmp_path / "policy.npz"), "2")
    policy = mjtactile.load_policy(tmp_path / "policy.npz")
    x = rng.standard_normal(30)
    np.testing.assert_allclose(policy(x), w @ x, atol=5e-3)
