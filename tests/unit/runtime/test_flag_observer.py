"""Tests that simulation flags reach every output: lines, recordings, pages, commands,
environments."""

import json

import gymnasium
import numpy as np
import pytest

import mjtactile.gym
from mjtactile.cli import main
from mjtactile.core.flags import FlagTracker, read_flags
from mjtactile.core.scenario import Scenario
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.evaluate.report import page
from mjtactile.export.episode import RecordedEpisode as Exported
from mjtactile.recording.files import to_json
from mjtactile.recording.observer import Observer
from mjtactile.recording.reader import load_recording
from mjtactile.runtime.flag_observer import FlagObserver

# closes on the block, whose faces have edges within the membrane's frame, and ends there
CLOSES = """
from dataclasses import replace

def step(observation):
    c = observation.command
    t = c.memory.get("t", 0.0) + observation.period
    opening = max(0.0, c.opening - 0.06 * observation.period)
    phase = "close" if t < 1.3 else "done"
    return replace(c, opening=opening, force_limit=1.0, phase=phase, memory={"t": t})
"""
SCENE = {"object": "block", "sensor": "paper16", "effects": "-images"}


@pytest.fixture(scope="module")
def closed(tmp_path_factory):
    """Provide an episode of `evaluate` that ends on the block: its line, its recording's folder."""
    folder = tmp_path_factory.mktemp("flags")
    (folder / "closes.py").write_text(CLOSES)
    scenario = Scenario(controller=str(folder / "closes.py"), **SCENE)
    line = run_episode(Episode(0, scenario, recording=str(folder / "recording")))
    return line, folder


def test_a_flag_is_in_the_line_the_recording_and_the_export(closed):
    line, folder = closed
    edge = line["flags"]["sharp_edge"]
    assert "a sharp edge is in contact" in edge["reason"]
    recording = load_recording(folder / "recording")
    assert to_json(recording.flags) == line["flags"]
    # the jaws close on the block for the last part of the run and are in contact at its end
    times = recording.columns["time"]
    assert times[0] < edge["first_s"] < edge["last_s"]
    assert edge["last_s"] == pytest.approx(times[-1], abs=0.1)
    assert edge["fraction"] == pytest.approx(1 - edge["first_s"] / edge["last_s"], abs=0.05)
    assert Exported(folder / "recording").facts["notes"]["flags"] == line["flags"]


def test_a_flag_is_on_the_pages_and_the_command_prints_it(closed, capsys):
    line, folder = closed
    assert main(["summary", str(folder), "--out", str(folder / "one.html")]) == 0
    edge = read_flags(line["flags"])["sharp_edge"]
    assert f"warning (sharp_edge): {edge} ({edge.when})\n" in capsys.readouterr().out
    page = (folder / "one.html").read_text()
    for text in (page, _report(line)):
        assert edge in text
    assert f"<td>{edge.first:.2f}</td><td>{edge.last:.2f}</td>" in page


def _report(line):
    options = {"controllers": ["closes"], "scenario": {}}
    return page({"options": options, "versions": {}}, [line], [], {})


@pytest.mark.slow
def test_a_flag_is_in_the_output_of_grasp(closed, tmp_path, capsys):
    line, folder = closed
    options = [f"--{key}={value}" for key, value in SCENE.items()]
    controller = f"--controller={folder / 'closes.py'}"
    main(["grasp", *options, controller, "--out", str(tmp_path / "run")])
    edge = line["flags"]["sharp_edge"]["reason"]
    assert capsys.readouterr().out.count(f"warning (sharp_edge): {edge}") == 1
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["flags"] == line["flags"]  # the same world, bit for bit


@pytest.mark.slow
def test_an_environment_returns_its_flags_and_clears_them_at_reset():
    close = np.array([-1.0, 0.0, -0.9], np.float32)
    with gymnasium.make(mjtactile.gym.ID, **SCENE) as env:
        _, info = env.reset(seed=0)
        assert info["flags"] == {}
        for _ in range(45):
            *_, info = env.step(close)
        assert "sharp_edge" in info["flags"]
        assert env.reset(seed=1)[1]["flags"] == {}


def test_flags_are_recorded_when_they_change_and_at_the_end():
    flags = {}
    noted = []

    class NoteObserver(Observer):
        def note(self, **facts):
            noted.append({"flags": dict(facts["flags"])})

    with FlagObserver(lambda: flags, NoteObserver()) as notes:
        notes.on_images()
        flags["sharp_edge"] = "an edge presses"
        notes.on_images()
        notes.on_images()
        flags["frame_contact"] = "the frame carries 3.0 N"
    both = {"sharp_edge": "an edge presses", "frame_contact": "the frame carries 3.0 N"}
    assert noted == [{"flags": {"sharp_edge": "an edge presses"}}, {"flags": both}]


def test_the_last_record_has_the_final_times():
    tracker = FlagTracker(0.0)
    noted = []

    class NoteObserver(Observer):
        def note(self, **facts):
            noted.append(facts["flags"]["sharp_edge"].last)

    with FlagObserver(tracker.flags, NoteObserver()) as notes:
        tracker.update(1.0, {"sharp_edge": "an edge presses"})
        notes.on_images()
        tracker.update(2.0, {"sharp_edge": "an edge presses"})
        notes.on_images()
        tracker.update(3.0, {})
    assert noted == [1.0, 3.0]
