"""Tests of `mjtactile new` and `mjtactile docs`: copies work unchanged under their own names."""

import json

import pytest

from mjtactile.cli import main
from mjtactile.commands.new import KINDS
from mjtactile.core import resources
from mjtactile.core.design import load_sensor
from mjtactile.core.task import load_task
from mjtactile.rig.domain_randomization import load_variation
from mjtactile.rig.file import read_rig_file
from mjtactile.rig.registry import build_rig
from mjtactile.rig.scenario import load_scenario
from mjtactile.runtime.controller import load_controller
from mjtactile.sim.scenes.objects import load_object
from tests.cli.test_bad_input import assert_one_line

LOAD = {
    "controller": load_controller,
    "sensor": load_sensor,
    "object": load_object,
    "rig": read_rig_file,
    "task": load_task,
    "variation": load_variation,
    "scenario": load_scenario,
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_shipped_file_can_be_copied_and_the_copy_is_good(capsys, monkeypatch, tmp_path, kind):
    monkeypatch.chdir(tmp_path)
    for like in resources.names(KINDS[kind].folder, KINDS[kind].suffix):
        assert main(["new", kind, f"my_{like}", "--template", like, "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        copy = tmp_path / report["file"]
        assert copy.name == f"my_{like}{KINDS[kind].suffix}" and copy.name in report["next"]
        loaded = LOAD[kind](copy)
        assert kind in ("controller", "scenario") or loaded.name == f"my_{like}"
        assert "#" in copy.read_text() or "<!--" in copy.read_text()  # its comments are kept


def test_a_copied_simulated_rig_includes_its_robot(command, tmp_path):
    report = json.loads(command("new", "rig", "mine", "--template", "sim", "--json").stdout)
    assert report["files"] == ["mine.toml", "mine.xml"]
    rig = read_rig_file(tmp_path / "mine.toml")
    assert command("docs", "rig_files").returncode == 0  # which it names as the page to read
    assert (
        rig.model == tmp_path / "mine.xml"
        and [
            finger.design.name
            for finger in build_rig(str(tmp_path / "mine.toml"), load_sensor("paper16")).fingers
        ]
        == ["paper16"] * 2
    )
    assert_one_line(
        command("new", "rig", "mine.toml", "--template", "sim_arm"), ["mine.toml", "exists already"]
    )
    (tmp_path / "other.xml").write_text("precious")
    assert_one_line(
        command("new", "rig", "other", "--template", "sim"), ["other.xml", "exists already"]
    )
    assert (tmp_path / "other.xml").read_text() == "precious" and not (
        tmp_path / "other.toml"
    ).exists()


def test_a_random_object_is_written_to_be_viewed(command, tmp_path):
    report = json.loads(
        command("new", "object", "thing", "--template", "random:7", "--json").stdout
    )
    assert (
        report["like"] == "random:7"
        and load_object(tmp_path / "thing.xml").mass == load_object("random:7").mass
    )
    assert_one_line(
        command("new", "object", "other", "--template", "random"),
        ["'random' is not a shipped file", "random:N"],
    )


def test_the_printed_next_command_runs(command, tmp_path):
    process = command("new", "sensor", "mine")
    assert process.returncode == 0 and process.stderr == ""
    words = process.stdout.splitlines()[1].split()
    assert words[0] == "mjtactile" and command(*words[1:]).returncode == 0
    words = process.stdout.splitlines()[2].split()
    assert (
        words == ["mjtactile", "docs", "sensor_files"]
        and "describes a tactile sensor" in command(*words[1:]).stdout
    )


@pytest.mark.slow(10)
def test_a_copied_controller_grasps_a_copied_object(command, tmp_path):
    for kind, name in (("object", "plum.xml"), ("controller", "mine.py")):
        assert command("new", kind, name).returncode == 0
    report = json.loads(
        command(
            "grasp",
            "--object",
            "./plum.xml",
            "--controller",
            "./mine.py",
            "--effects=-images,-mesh,-pipeline",
            "--out",
            "result",
            "--json",
        ).stdout
    )
    assert (report["outcome"], report["object"], report["controller"]) == ("held", "plum", "mine")


def test_no_file_is_overwritten(command, tmp_path):
    (tmp_path / "mine.toml").write_text("precious")
    for name in ("mine", "mine.toml"):
        assert_one_line(command("new", "sensor", name), ["mine.toml", "exists already"])
    assert (tmp_path / "mine.toml").read_text() == "precious"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("new", "gripper", "x"), ["gripper", "controller", "rig"]),
        (("new", "sensor", "x", "--template", "egg"), ["--template", "egg", "dense", "paper16"]),
        (("new", "sensor", "no/such/x"), ["no/such/x.toml", "cannot be written"]),
        (("new", "controller", "x.txt"), ["x.txt", "'controller' ends in .py"]),
        (("new", "sensor", "x.xml"), ["x.xml", "'sensor' ends in .toml"]),
        (("docs", "nothing"), ["nothing", "reference/sensor_files", "how-to/controllers"]),
    ],
)
def test_bad_usage(command, args, words):
    assert_one_line(command(*args), words)


def test_a_name_may_have_a_dot(command, tmp_path):
    assert command("new", "sensor", "v1.2").returncode == 0
    assert (tmp_path / "v1.2.toml").exists()


@pytest.mark.parametrize("name", [".", "/"])
def test_a_folder_is_refused_as_a_file_name(command, name):
    done = command("new", "object", name)
    assert done.returncode == 2 and "is a folder, not the name of a new file" in done.stderr


def test_docs_lists_every_page_with_its_title(command):
    report = json.loads(command("docs", "--json").stdout)
    assert report["pages"]["reference/sensor_files"] and {
        "validation/benchmarks",
        "how-to/hardware",
    } <= set(report["pages"])
    listed = command("docs").stdout
    assert all(title.strip() and title in listed for title in report["pages"].values())
