"""`mjtactile evaluate`: the same lines with any number of workers, after an interruption, and from
shards."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.commands.evaluate import _objects
from mjtactile.export.episode import find_episodes
from mjtactile.recording.reader import load_recording
from tests.emulated_host import controller_text

SAMPLED = "--effects=-images,-mesh,-pipeline"  # the fastest level: these tests do not check physics
COMMON = [
    "--controller",
    "quick.py",
    "--objects",
    "vial,egg",
    "--episodes",
    "2",
    "--randomization",
    "none",
    "--worst",
    "1",
    SAMPLED,
    "--seed",
    "7",
]


@pytest.mark.slow(10)
def test_interrupted_resumed_and_in_shards(tmp_path, command):
    (tmp_path / "quick.py").write_text(controller_text(hold=0.1))
    host = subprocess.Popen(
        [sys.executable, "-m", "mjtactile", "evaluate", *COMMON, "--workers", "1", "--out", "one"],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    episodes = tmp_path / "one" / "episodes.jsonl"
    deadline = time.monotonic() + 600
    while not (episodes.exists() and episodes.read_text().count("\n")):
        assert host.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    os.killpg(host.pid, signal.SIGKILL)
    host.wait()
    kept = episodes.read_text()
    with episodes.open("a") as file:
        file.write('{"episode": 1, "contr')  # a line that was cut off
    refused = command("evaluate", *COMMON, "--out", "one")
    assert refused.returncode == 2
    assert "--out: already holds an evaluation; --resume continues it" in refused.stderr
    resume = ("--workers", "1", "--out", "one", "--resume", "--json")
    summary = json.loads(command("evaluate", *COMMON, *resume).stdout)
    assert set(kept.splitlines()) <= set(episodes.read_text().splitlines())
    assert (
        summary["controllers"]["quick"]["episodes"] == 2
        and summary["controllers"]["quick"]["held"] == 2
    )
    assert list(summary["controllers"]["quick"]["objects"]) == ["vial", "egg"]
    report = (tmp_path / "one" / "report.html").read_text()
    assert report.count("data:image/png") == 1 and "mjtactile grasp --object" in report
    for part, workers in (("1/2", 2), ("2/2", 1)):
        arguments = (
            "--workers",
            workers,
            "--worst",
            "0",
            "--shard",
            part,
            "--out",
            f"part{part[0]}",
        )
        assert command("evaluate", *COMMON, *arguments).returncode == 0
    merge = ("--merge", "part2", "part1", "--worst", "0", "--out", "whole")
    assert command("evaluate", *merge).returncode == 0
    assert (tmp_path / "whole" / "episodes.jsonl").read_bytes() == episodes.read_bytes()
    refused = command("evaluate", *COMMON[:-1], "8", "--out", "one", "--resume")
    assert refused.returncode == 2
    assert "was started with different options: scenario.seed " in refused.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--objects", "egg,stone"], "stone: unknown object"),
        (["--objects", "egg,my/*.xml"], "my/*.xml: --objects: no file"),
        (["--controller", "no.py"], "no.py"),
        (["--shard", "3/2"], "is not K/N"),
        (["--episodes", "0"], "at least 1"),
        (["--resume"], "which folder?"),
        (["--randomization", "no.toml"], "no.toml: randomization: no such file"),
        (["--randomization", "defalt"], "unknown variation"),
        (["--task", "poor"], "poor: unknown task (valid: bump, "),
        (["--effects", "+bendig"], "is not +NAME"),
        (["--rig", "two_xm430"], "two_xm430"),
        (
            ["--controller", "gentle", "--controller", "gentle"],
            "two controllers have the name 'gentle'",
        ),
    ],
)
def test_invalid_options_are_refused(capsys, words, text):
    assert main(["evaluate", *words]) == 2
    reported = capsys.readouterr().err
    assert text in reported and len(reported.strip().splitlines()) == 1


def test_a_pattern_of_objects_expands_to_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("b.xml", "a.xml", "a.toml"):
        (tmp_path / name).write_text("")
    assert _objects("egg, *.xml,random") == ["egg", "a.xml", "b.xml", "random"]
    assert _objects(f"{tmp_path}/[a].*") == [str(tmp_path / "a.toml"), str(tmp_path / "a.xml")]


@pytest.mark.slow
def test_the_command_of_an_episode_samples_the_same_world(tmp_path, command):
    (tmp_path / "quick.py").write_text(controller_text(hold=0.1))
    (tmp_path / "my.toml").write_text(
        "[object]\nmass_percent = [100, 200]\n[sensor]\nblur_px = [0, 1]\n"
    )
    arguments = [
        SAMPLED,
        "--controller",
        "quick.py",
        "--objects",
        "vial",
        "--seed",
        "3",
        "--randomization",
        "my.toml",
    ]
    command("evaluate", *arguments, "--episodes", "1", "--worst", "0", "--record", "--out", "one")
    line = json.loads((tmp_path / "one" / "episodes.jsonl").read_text())
    assert (
        line["randomized"].keys() == {"object.mass_percent", "left.blur_px", "right.blur_px"}
        and "--randomization=my.toml" in line["rerun_command"]
    )
    again = json.loads(
        command(*shlex.split(line["rerun_command"])[1:], "--out", "again", "--json").stdout
    )
    assert all(
        again[name] == line[name]
        for name in ("outcome", "hold_force_true_N", "peak_force_N", "slip_mm_true", "frames")
    )
    # the recording kept by --record, an input of `export`
    (kept,) = find_episodes(tmp_path / "one")
    first = kept.recording
    second = load_recording(tmp_path / "again" / "recording")
    assert (
        first.folder == tmp_path / "one" / "recordings" / "quick-000000"
        and first.notes["outcome"] == line["outcome"]
    )
    estimated = [recording.column("force_normal") for recording in (first, second)]
    assert np.array_equal(*estimated, equal_nan=True)  # a sampled touch may be None
    assert first.header["command"] == line["rerun_command"]
    assert line["time_s"] == pytest.approx(np.ptp(first.column("time")))
    log = (tmp_path / "again" / "recording" / "log.jsonl").read_text().splitlines()
    assert any(json.loads(entry).get("randomized") == line["randomized"] for entry in log)
