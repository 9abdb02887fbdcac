"""Tests of calibration files named in a rig file: errors take one line, `doctor` reports the status
of the others, and commands find them."""

import json

import pytest

from mjtactile.cli import main
from mjtactile.core import resources
from mjtactile.core.calibration import Calibration, load_calibration
from mjtactile.core.calibration_parts import ForceScale, LensCalibration, ValveZero, stamp
from mjtactile.core.design import load_sensor
from mjtactile.rig.file import load_rig_file
from mjtactile.rig.gripper_calibration import calibrated_gripper

DESIGN = load_sensor("dense")
MARK = stamp(DESIGN, {}, {})
LENS = LensCalibration(
    640, 480, 618.0, 618.0, 325.0, 235.0, (-0.09, 0.01, 0.0, 0.0, 0.0), stamp=MARK
)


@pytest.fixture
def rig(tmp_path):
    """Provide the file of a real rig without its devices. It names calibration files; the left one
    exists."""
    text = resources.find("two_xm430", "models/rigs", ".toml").read_text()
    text = text.replace("[gripper]\n", '[gripper]\ncalibration = "gripper.json"\n')
    for finger in ("left", "right"):
        text = text.replace(
            f'[[camera]]\nfinger = "{finger}"',
            f'[[camera]]\nfinger = "{finger}"\ncalibration = "{finger}.json"',
        )
    path = tmp_path / "rig.toml"
    path.write_text(text)
    Calibration("left", "dense").with_part(LENS).with_part(ValveZero(30.0, 5.0, MARK)).save(
        tmp_path / "left.json"
    )
    return path


def one_line(capsys, *arguments):
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and all(word in lines[0] for word in arguments), lines


def cut_in_half(folder):
    path = folder / "left.json"
    path.write_text(path.read_text()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (cut_in_half, ("left.json", "not valid JSON")),
        (
            lambda folder: Calibration("left", "paper16").save(folder / "left.json"),
            ("left.json", "sensor", "'paper16'", "'dense'"),
        ),
        (
            lambda folder: Calibration("right", "dense").save(folder / "left.json"),
            ("left.json", "finger", "'right'", "'left'"),
        ),
        (
            lambda folder: (folder / "gripper.json").write_text('{"calibration": "force"}'),
            ("gripper.json", "valid: gripper"),
        ),
    ],
)
def test_a_calibration_of_another_device_is_refused_before_the_grasp(
    rig, tmp_path, capsys, spoil, words
):
    spoil(tmp_path)
    if "gripper.json" in words:  # read when the servos are connected, after the cameras
        with pytest.raises(Exception, match="valid: gripper"):
            calibrated_gripper(load_rig_file(rig).gripper)
    else:
        assert main(["grasp", "--rig", str(rig), "--out", str(tmp_path / "out")]) == 2
        one_line(capsys, *words)
    assert main(["doctor", "--rig", str(rig), "--json"]) == 1
    bad = [
        f["text"] for f in json.loads(capsys.readouterr().out)["findings"] if f["level"] == "bad"
    ]
    assert any(all(word in text for word in words) for text in bad)


def without_cameras(text):
    return "[[".join(part for part in text.split("[[") if not part.startswith("camera]]"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda text: text.replace('finger = "right"', 'finger = "left"'),
            ("camera", "['left', 'left']"),
        ),
        (without_cameras, ("camera", "missing field")),
    ],
)
def test_duplicate_finger_names_and_missing_fingers_are_refused(
    rig, tmp_path, capsys, change, words
):
    rig.write_text(change(rig.read_text()))
    assert main(["grasp", "--rig", str(rig), "--out", str(tmp_path / "out")]) == 2
    one_line(capsys, "rig.toml", *words)


def test_doctor_lists_missing_refused_and_outdated_files(rig, tmp_path, capsys):
    # its values differ from those of the sensor file
    stale = ForceScale(1.02, 0.01, 1.5, stamp(load_sensor("paper16"), {}, {}))
    load_calibration(tmp_path / "left.json").with_part(stale).with_refusal("frame", ["bent"]).save(
        tmp_path / "left.json"
    )
    main(["doctor", "--rig", str(rig), "--json"])
    found = {f["subject"]: f for f in json.loads(capsys.readouterr().out)["findings"]}
    assert found["calibration of left, lens"]["level"] == "ok"
    assert (
        "refused" in found["calibration of left, frame"]["text"]
        and "bent" in found["calibration of left, frame"]["text"]
    )
    assert (
        "values of the sensor file have changed since"
        in found["calibration of left, force"]["text"]
    )
    assert found["calibration of right, lens"]["text"].startswith("never measured")
    assert found["calibration of right, lens"]["remedy"] == (
        f"`mjtactile calibrate camera --rig {rig} --finger right`"
    )
    assert found["calibration of the gripper"]["level"] == "warn"


def test_a_rig_without_a_calibration_file_states_where_to_name_it(capsys):
    assert main(["calibrate", "force", "--rig", "two_xm430", "--finger", "right"]) == 2
    one_line(capsys, "camera[1].calibration", 'calibration = "right.json"')


def test_the_measured_backlash_of_the_gripper_is_compensated(rig, tmp_path):
    """Jaws 0.1 mm behind their servos in both directions have a play of 0.2 mm."""
    rows = ["reported_mm,direction,measured_mm"]
    for opening in (20, 40, 60, 80):
        rows += [f"{opening},closing,{opening + 0.1}", f"{opening},opening,{opening - 0.1}"]
    (tmp_path / "caliper.csv").write_text("\n".join(rows))
    command = ["calibrate", "gripper", "--rig", str(rig), "--openings"]
    assert main([*command, str(tmp_path / "caliper.csv")]) == 0
    config = load_rig_file(rig).gripper
    assert config.backlash == 0.0
    assert calibrated_gripper(config).backlash == pytest.approx(2e-4, rel=1e-3)


def test_gripper_calibration_is_used_until_the_rig_file_changes(rig, tmp_path):
    rows = "\n".join(["reported_N,measured_N", *(f"{f},{0.9 * f}" for f in (1, 2, 3, 4))])
    (tmp_path / "cell.csv").write_text(rows)
    assert (
        main(["calibrate", "gripper", "--rig", str(rig), "--forces", str(tmp_path / "cell.csv")])
        == 0
    )
    config = load_rig_file(rig).gripper
    assert [s.torque_per_A for s in calibrated_gripper(config).servos] == pytest.approx(
        [0.9 * 1.78] * 2, rel=1e-3
    )
    rig.write_text(rig.read_text().replace("zero_ticks = 1024", "zero_ticks = 1030"))
    config = load_rig_file(rig).gripper
    assert calibrated_gripper(config) == config
