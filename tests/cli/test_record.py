"""Tests of `mjtactile record`: no motion, a complete recording, and a replay with the same
values."""

import json
import shutil

import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.recording.reader import load_recording
from tests.pages import Balanced


def record(capsys, *arguments):
    code = main(["record", *map(str, arguments), "--sensor", "paper16", "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("watch")
    assert (
        main(
            [
                "record",
                "--rig",
                "sim",
                "--sensor",
                "paper16",
                "--seconds",
                "0.3",
                "--out",
                str(folder),
            ]
        )
        == 0
    )
    return folder


def test_record_commands_no_motion(folder):
    recording = load_recording(folder)
    assert recording.complete and recording.notes["outcome"] == "recorded"
    assert len(recording) == pytest.approx(0.3 * 30, abs=1)
    assert (
        np.ptp(recording.column("command_opening", 1)) == 0
        and np.ptp(recording.column("command_lift_height", 1)) == 0
    )
    assert np.ptp(recording.column("opening", 1)) < 1e-4  # range, m; the jaws do not move
    assert [phase for phase, *_ in recording.phases()][-1] == "done"


def test_a_recording_contains_its_provenance(folder):
    header = load_recording(folder).header
    assert header["versions"]["mjtactile"] and header["versions"]["opencv"]
    assert "[membrane]" in header["files"]["sensor"]["text"]
    assert header["design"] == "paper16" and header["rig"] == "sim"


def test_a_replay_gives_the_same_numbers(folder, tmp_path, capsys):
    code, result = record(
        capsys, "--rig", f"replay:{folder}", "--seconds", "0.3", "--out", tmp_path
    )
    first = load_recording(folder)
    second = load_recording(tmp_path)
    assert code == 0 and result["cycles"] == len(first) == len(second)
    for key in (
        "time",
        "image_time",
        "force_normal",
        "force_normal_sd",
        "opening",
        "effort",
        "gripper_time",
        "valve_time",
    ):
        # bit for bit
        assert np.array_equal(first.column(key), second.column(key), equal_nan=True), key
    assert second.notes["simulated"] == first.notes["simulated"]  # the images are of that world
    for a, b in zip(first.images(), second.images(), strict=True):
        assert all(np.array_equal(x.pixels, y.pixels) for x, y in zip(a, b, strict=True))


def test_the_page_of_a_recording_repeats_the_estimates(folder, tmp_path, capsys):
    assert main(["summary", str(folder), "--out", str(tmp_path / "page.html"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    page = Balanced((tmp_path / "page.html").read_text())
    estimated = [shot["estimates"][0]["text"] for shot in json.loads(page.scripts[0])["shots"]]
    assert result["re_estimate"] and result["shown"] == result["cycles"] == len(estimated)
    reported = load_recording(folder).column("force_normal")[:, 0]
    # as written, two digits
    assert [float(text.split()[0]) for text in estimated] == pytest.approx(reported, abs=0.0051)
    assert "hyperelasticity" in page.text  # list of simulated effects


def test_a_recording_stops_at_its_end(folder, tmp_path, capsys):
    code, result = record(capsys, "--rig", f"replay:{folder}", "--out", tmp_path)  # 10 s, of 0.3
    assert code == 0 and result["cycles"] == len(load_recording(folder))
    assert load_recording(tmp_path).notes["outcome"] == "recorded"


def test_a_part_of_a_recording_with_the_gripper_raised(folder, tmp_path, capsys):
    """The part is complete: a recording cannot lower the gripper, and the remaining time was not
    requested."""
    raised = tmp_path / "raised"
    shutil.copytree(folder, raised)
    lines = [
        json.loads(line) for line in (raised / "recording" / "log.jsonl").read_text().splitlines()
    ]
    written = [line | {"lift_height": 0.02} if "lift_height" in line else line for line in lines]
    (raised / "recording" / "log.jsonl").write_text(
        "".join(json.dumps(line) + "\n" for line in written)
    )
    out = tmp_path / "part"
    code, result = record(capsys, "--rig", f"replay:{raised}", "--seconds", "0.2", "--out", out)
    assert code == 0 and result["cycles"] == pytest.approx(0.2 * 30, abs=1)
    assert load_recording(out).notes["outcome"] == "recorded"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--rig", "nowhere"), "--rig"),
        (("--rig", "sim", "--seconds", "-1"), "--seconds"),
        (("--rig", "replay:nowhere"), "nowhere"),
    ],
)
def test_bad_input(arguments, word, tmp_path, capsys):
    code, result = record(capsys, *arguments, "--out", tmp_path / "out")
    assert code == 2 and word in result["error"]
