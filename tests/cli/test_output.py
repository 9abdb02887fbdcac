"""Tests of output: a failed or blocked output does not block a command, and `--out` overwrites no
file."""

import json
import os
import pty
import subprocess
import sys
import termios
from concurrent.futures import ThreadPoolExecutor

import pytest

from mjtactile.cli import main
from mjtactile.recording.reader import load_recording
from mjtactile.rig.file import load_rig_file

WAIT = 300  # time limit on a busy computer, s

# Write far more than a pipe or a terminal buffers, then report the end.
CHATTER = """
import os, sys
from pathlib import Path
from mjtactile.commands.output import stdout_to_stderr
with stdout_to_stderr():
    for i in range(3000):
        print("a line of what happens, number", i)
        os.write(2, b"and one of a C library\\n")
Path("end").write_text("reached")
"""


@pytest.mark.parametrize("output", ["closed pipe", "full disk", "stopped terminal"])
def test_a_blocked_output_does_not_block_the_program(tmp_path, output):
    if output == "closed pipe":
        reader, writer = os.pipe()
        os.close(reader)
    elif output == "full disk":
        writer = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, writer = pty.openpty()
        termios.tcflow(writer, termios.TCOOFF)  # Ctrl-S
    process = subprocess.run(
        [sys.executable, "-c", CHATTER],
        cwd=tmp_path,
        stdout=writer,
        stderr=writer,
        timeout=WAIT,
        check=False,
    )
    assert process.returncode == 0
    assert (tmp_path / "end").exists()


def test_a_working_output_receives_every_line(tmp_path):
    process = subprocess.run(
        [sys.executable, "-c", CHATTER],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=WAIT,
        check=True,
    )
    assert process.stdout == ""
    assert process.stderr.count("what happens") == process.stderr.count("C library") == 3000


# -- folders
# --------------------------------------------------------------------------------

RECORD = ("record", "--rig", "sim", "--sensor", "paper16", "--seconds", "0.1")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "old"
    assert main([*RECORD, "--out", str(folder)]) == 0
    return folder


@pytest.mark.parametrize(
    "command",
    [
        ("grasp", "--object", "typo"),
        ("grasp",),
        RECORD,
        ("record", "--rig", "replay:{old}", "--sensor", "paper16"),
        ("probe",),
    ],
)
def test_an_older_run_is_refused_and_kept(run_folder, capsys, command):
    before = {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()}
    assert main([*(word.format(old=run_folder) for word in command), "--out", str(run_folder)]) == 2
    assert "already contains recording" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()} == before
    assert load_recording(run_folder).complete


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("press", "--indenter", "sphere:5"), "press.png"),
        (("inflate", "--pressure-kPa", "1"), "inflate.json"),
        (("experiments",), "experiments.md"),
    ],
)
def test_older_results_are_refused_and_kept(tmp_path, capsys, command, name):
    (tmp_path / name).write_text("precious")
    assert main([*command, "--out", str(tmp_path)]) == 2
    assert f"already contains {name}" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "precious"


@pytest.mark.parametrize(
    "command",
    [
        ("grasp", "--object", "typo", "--out", "new/run"),
        ("grasp", "--object", "typo"),
        ("probe", "--object", "typo", "--out", "new"),
        ("record", "--rig", "nowhere", "--out", "new"),
        ("bench", "rig", "--parts", "foo", "--out", "new"),
    ],
)
def test_a_run_that_did_not_start_leaves_no_folder(tmp_path, capsys, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    assert main(list(command)) != 0
    assert not list(tmp_path.iterdir())


def test_two_concurrent_runs_into_one_folder(mjtactile, tmp_path):
    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(lambda _: mjtactile(*RECORD, "--out", "both", "--json"), range(2)))
    good, refused = sorted(runs, key=lambda run: run.returncode)
    assert (good.returncode, refused.returncode) == (0, 2)
    assert "already" in json.loads(refused.stdout)["error"]
    recording = load_recording(tmp_path / "both")
    assert recording.complete and len(recording) == json.loads(good.stdout)["cycles"]


def test_default_names_do_not_collide_within_a_second(tmp_path, monkeypatch):
    from mjtactile.commands.output import new_run_folder

    monkeypatch.chdir(tmp_path)
    folders = []
    for _ in range(5):
        with new_run_folder("egg") as folder:
            (folder / "result").touch()
            folders.append(folder)
    assert len(set(folders)) == 5 and len(list((tmp_path / "runs").iterdir())) == 5


class Hardware:
    """Emulated hardware that ends at once, each with its own ports."""

    started = 0

    def __init__(self, *_, **__):
        Hardware.started += 1
        end = f"/dev/pts/{Hardware.started}"
        self.endpoints = {"servo": end, "valve": end, "cameras": {"left": "a", "right": "b"}}

    def truth(self):
        raise KeyboardInterrupt

    def close(self):
        pass


def test_an_emulator_replaces_only_its_own_rig_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("mjtactile.emulator.process.EmulatorProcess", Hardware)
    monkeypatch.setattr("sys.stdin", [])
    monkeypatch.setattr("time.sleep", lambda _: None)
    out = tmp_path / "rig.toml"
    for port in ("/dev/pts/1", "/dev/pts/2"):
        assert main(["emulate", "--out", str(out)]) == 0
        assert load_rig_file(out).bus.port == port
    out.write_text("name = 'precious'\n")
    assert main(["emulate", "--out", str(out)]) == 2
    assert "exists already, and nothing is overwritten" in capsys.readouterr().err
    assert out.read_text() == "name = 'precious'\n" and Hardware.started == 2
