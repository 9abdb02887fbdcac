"""Tests of bad input: exit code 2, one clear line that names the file, the field and the choices,
and no files left."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mjtactile.core import resources
from mjtactile.recording.reader import load_recording

EGG = resources.find("egg", "models/objects", ".xml").read_text()
DENSE = resources.find("dense", "models/sensors", ".toml").read_text()

STREAM = (
    resources.find("two_xm430", "models/rigs", ".toml")
    .read_text()
    .replace(
        'timestamps = "kernel"',
        """backend = "ffmpeg"
timestamps = "arrival\"""",
    )
    .replace('"/dev/v4l/by-id/usb-Arducam_Left-video-index0"', '"http://127.0.0.1:9/left"')
)

ROBOT = (
    resources.find("sim", "models/rigs", ".toml")
    .read_text()
    .replace(
        "../grippers/two_finger.xml", str(resources.folder("models/grippers") / "two_finger.xml")
    )
)


def bad_object(before, after, *arguments):
    """Return the egg's file with one change, and words that the message must contain."""
    return "--object", "a.xml", EGG.replace(before, after), ["a.xml", *arguments]


def bad_sensor(before, after, *arguments):
    return "--sensor", "a.toml", DENSE.replace(before, after), ["a.toml", *arguments]


def bad_rig(before, after, *arguments):
    return "--rig", "a.toml", ROBOT.replace(before, after), ["a.toml", *arguments]


def bad_controller(text, *arguments):
    return "--controller", "a.py", text, ["a.py", *arguments]


# case: option, file name, its text (None: not made), words that the message must have
CASES = {
    "empty scenario": ("--scenario", "", None, ["--scenario", "is empty"]),
    "accuracy below the solver's noise": ("--accuracy", "1e-12N", None, ["1e-12N", "0.0001 N"]),
    "unknown object": ("--object", "eg", None, ["eg", "egg", "strawberry", "vial"]),
    "unknown sensor": ("--sensor", "dens", None, ["dens", "dense", "paper16"]),
    "unknown controller": ("--controller", "rough", None, ["rough", "gentle"]),
    "object file missing": ("--object", "./no.xml", None, ["no.xml", "no such file"]),
    "broken MJCF": ("--object", "a.xml", "<mujoco><worldbody></mujoco>", ["a.xml", "MJCF"]),
    "no body named object": bad_object('"object"', '"egg"', "'object'"),
    "no free joint": bad_object("<freejoint/>", "", "free joint"),
    "no break force": bad_object("break_force_N", "strength", "break_force_N"),
    "position not a number": bad_object('"0 0 0.0315"', '"0 nan 0"', "pos of body 'object' is nan"),
    "friction not a number": bad_object(
        'name="shell" friction="0.3',
        'name="shell" friction="nan',
        "friction of geom 'shell' is nan",
    ),
    "unknown material": bad_object('"solid"', '"stone"', "material", "stone", "soft"),
    "wider than the jaws open": bad_object(
        "0.016 0.016 0.02",
        "0.06 0.06 0.06",
        "touches a sensor before",
        "they open to 80 mm",
        # a box with half sides of 60 mm in a file that allows any rotation about z: 120 to 170 mm
        "its bounding box is 1",
        "rotation_deg",
    ),
    "field missing": bad_sensor("young_MPa = 1.0", "", "membrane.young_MPa"),
    "misspelt": bad_sensor("young_MPa", "yung_MPa", "yung_MPa", "young_MPa"),
    "wrong unit": bad_sensor("young_MPa", "young_kPa", "young_kPa", "young_MPa"),
    "negative": bad_sensor("_MPa = 1.0", "_MPa = -1.0", "young_MPa", "-1.0"),
    "not finite": bad_sensor("_MPa = 1.0", "_MPa = nan", "young_MPa", "nan"),
    "not TOML": ("--sensor", "a.toml", "[frame", ["a.toml", "TOML"]),
    "no fingers": bad_rig("[[finger]]", "[[fingr]]", "finger", "'fingr'"),
    "two fingers of one name": bad_rig('"right"', '"left"', "finger.name", "'left'"),
    "null character in a name": bad_rig('"left"', '"le\\u0000ft"', "name", "null character"),
    "control character in a name": bad_rig('"left"', '"le\\nft"', "name", "control character"),
    "no such site": bad_rig(
        '"right_fingertip"', '"tip"', "finger[1].site", "'tip'", "right_fingertip"
    ),
    "no such actuator": bad_rig('"jaw"', '"jw"', "actuator[0].name", "'jw'", "jaw"),
    "robot file missing": bad_rig("two_finger.xml", "no.xml", "sim.model", "no.xml"),
    "controller does not import": bad_controller("import nothing_like_this", "nothing_like_this"),
    "controller without step": bad_controller("x = 1", "step"),
}


REPLACE = "from dataclasses import replace; return replace(observation.command"


def assert_one_line(process, words, code=2):
    assert process.returncode == code, process.stderr
    line = process.stderr.strip().splitlines()[-1]
    assert line.startswith("mjtactile: ")
    assert [word for word in words if word not in line] == []
    assert "Traceback" not in process.stderr


@pytest.mark.parametrize("case", CASES)
def test_bad_file_or_name(command, tmp_path, case):
    option, name, text, words = CASES[case]
    if text is not None:
        (tmp_path / name).write_text(text)
    before = set(tmp_path.iterdir())
    process = command("grasp", option, name, "--workers", "0", "--out", "result")
    assert_one_line(process, words)
    assert len(process.stderr.strip().splitlines()) == 1
    assert process.stdout == ""
    assert set(tmp_path.iterdir()) == before  # neither an empty result nor MuJoCo's log file


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("return 1 / 0", ["line 2", "ZeroDivisionError"]),
        ("return None", ["step", "None"]),
        pytest.param(
            f"{REPLACE}, opening=float('nan'))", ["opening", "nan"], marks=pytest.mark.slow
        ),
        pytest.param(
            f"{REPLACE}, phase='grab')", ["phase", "grab", "hold"], marks=pytest.mark.slow
        ),
    ],
)
def test_a_faulty_controller_is_named(command, tmp_path, body, words):
    (tmp_path / "bad.py").write_text(f"def step(observation):\n    {body}\n")
    process = command(
        "grasp", "--controller", "bad.py", "--effects=-mesh,-pipeline", "--out", "result", "--json"
    )
    assert_one_line(process, ["bad.py", *words])
    assert json.loads(process.stdout)["exit_code"] == 2


@pytest.mark.slow
def test_a_recording_before_a_controller_failure_is_kept(command, tmp_path):
    (tmp_path / "bad.py").write_text("""
def step(observation):
    if observation.time > 2.5:
        raise ValueError("tired")
    return observation.command
""")
    process = command(
        "grasp", "--controller", "bad.py", "--effects=-mesh,-pipeline", "--out", "result", "--json"
    )
    assert_one_line(process, ["bad.py", "line 4", "tired"])
    report = json.loads(process.stdout)
    assert report["outcome"] == "fault" and report["exit_code"] == 2
    assert len(load_recording(tmp_path / "result")) == report["frames"] > 0


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["grasp", "--seed", "-1"], ["--seed", "-1"]),
        (["grasp", "--rig", "dream"], ["--rig", "dream", "sim"]),
        (["grab"], ["grab", "grasp", "detect-circles"]),
        (["bench", "nothing"], ["nothing", "grasp", "perception"]),
        (
            ["detect-circles", "x.png", "--camera", "c.yaml", "--radius-mm", "0"],
            ["--radius-mm", "0"],
        ),
        (["detect-circles", "x.png", "--camera", "c.yaml", "--radius-mm", "1"], ["c.yaml"]),
        ([], ["COMMAND", "--help"]),
    ],
)
def test_bad_usage(command, args, words):
    process = command(*args)
    assert_one_line(process, words)
    assert process.stdout == ""


# In each of these cases OpenCV, FFmpeg or MuJoCo prints its own messages.
@pytest.mark.parametrize(
    ("files", "args", "words"),
    [
        (
            {"bad.mp4": b"xx"},
            ["reconstruct", "bad.mp4", "--sensor", "dense", "--out", "out"],
            ["bad.mp4"],
        ),
        (
            {"bad.png": b"\x89PNG"},
            ["reconstruct", "bad.png", "--sensor", "dense", "--out", "out"],
            ["bad.png"],
        ),
        (
            {"rig.toml": STREAM.encode()},
            ["grasp", "--rig", "rig.toml", "--out", "out"],
            ["left camera", "127.0.0.1:9"],
        ),
    ],
)
def test_the_error_line_is_printed_before_library_output(mjtactile, tmp_path, files, args, words):
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    process = mjtactile(*args)
    assert process.returncode in (2, 3)
    assert_one_line(process, words, process.returncode)
    assert len(process.stderr.strip().splitlines()) == 1, process.stderr
    assert not (tmp_path / "out").exists()  # no empty folder is left


def test_mujoco_messages_are_printed_with_debug_only(tmp_path):
    code = """if True:
        import mujoco, numpy as np
        from mjtactile import cli
        from mjtactile.sim.mujoco_log import route_warnings
        cli._quieten_libraries(debug=DEBUG)
        route_warnings()
        ball = "<body><freejoint/><geom size='1'/></body>"
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")
        data = mujoco.MjData(model)
        data.qvel[0] = np.nan
        mujoco.mj_step(model, data)
    """
    for debug in (False, True):
        process = subprocess.run(
            [sys.executable, "-c", code.replace("DEBUG", str(debug))],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        assert ("unstable" in process.stderr) == debug
    assert not list(tmp_path.iterdir())


def test_with_json_an_error_is_one_json_object_too(command):
    process = command("grasp", "--object", "stone", "--json")
    report = json.loads(process.stdout)
    assert report["exit_code"] == process.returncode == 2 and "stone" in report["error"]


def test_an_unwritable_output_folder_is_refused_before_the_run(command, tmp_path):
    (tmp_path / "file").write_text("")
    process = command("grasp", "--out", "file/result")
    assert_one_line(process, ["file/result", "--out", "cannot be written"])
    assert "approach" not in process.stderr


def test_debug_shows_where(command):
    process = command("grasp", "--object", "stone", "--debug")
    assert process.returncode == 2 and "Traceback" in process.stderr


def test_help_has_examples(command):
    for words in ([], ["grasp"], ["bench"], ["detect-circles"]):
        process = command(*words, "--help")
        assert process.returncode == 0 and process.stderr == ""
        assert "examples:" in process.stdout
        assert max(map(len, process.stdout.splitlines())) <= 120
    words = command("grasp", "--help").stdout.replace(",", " ").split()
    assert {"egg", "strawberry", "vial", "dense", "paper16", "gentle"} <= set(words)
    assert command("--version").stdout.startswith("mjtactile 0.")


def test_no_file_is_left_in_the_working_folder(command, tmp_path):
    command("grasp", "--object", "stone")
    assert list(Path(tmp_path).iterdir()) == []


@pytest.mark.parametrize(
    ("field", "value"), [("accuracy", "-1N"), ("accuracy", "nan"), ("effects", "+ghost")]
)
@pytest.mark.parametrize("name", ["grasp", "evaluate"])
def test_a_wrong_value_in_a_scenario_file_names_file_and_field(
    command, tmp_path, name, field, value
):
    (tmp_path / "a.toml").write_text(f'{field} = "{value}"\n')
    done = command(name, "--scenario", "a.toml")
    assert done.returncode == 2
    assert done.stderr.startswith(f"mjtactile: a.toml: {field}: ")
    assert value in done.stderr
    assert not list((tmp_path / "runs").glob("*/episodes*"))


@pytest.mark.parametrize("option", ["--accuracy", "--effects", "--object"])
def test_an_empty_option_is_not_its_default(command, option):
    done = command("grasp", f"{option}=")
    assert done.returncode == 2
    assert f"argument {option}: is empty" in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", "--backend=ray"),
        ("evaluate", "--scheduler=tcp://a:1"),
        ("evaluate", "--readme=none.md"),
        ("evaluate", "--accuracy=-1"),
        ("explore", "--accuracy=nan"),
        ("design", "--seed=-1"),
        ("studio", "--no-browser", "--object=eg"),
        ("studio", "--no-browser", "--controller=gentl"),
        ("studio", "--no-browser", "--task=lif"),
    ],
)
def test_a_wrong_option_is_refused_before_anything_starts(command, tmp_path, words):
    done = command(*words)
    assert done.returncode == 2
    option, _, value = words[-1].partition("=")
    assert option in done.stderr or value in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("grasp", "--object", "\udcff.xml"), "\\udcff.xml: object: no such file"),
        (("grasp", "--rig", "sim:1"), "--rig: unknown rig 'sim:1'"),
        (("new", "object", ".."), "..: is a folder"),
    ],
)
def test_unknown_names_are_refused(command, tmp_path, words, message):
    done = command(*words)
    assert done.returncode == 2
    assert done.stderr.startswith(f"mjtactile: {message}")
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
