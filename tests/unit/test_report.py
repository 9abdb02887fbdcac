"""The picture and the progress line come out whatever the run was like."""

import io
import sys

import cv2
import numpy as np
import pytest

from mjtactile import report
from mjtactile.errors import MjtactileError
from mjtactile.progress import Progress
from mjtactile.recording import Recorder, load_recording
from tests.fake_run import fake_cycle, write_fake_recording

SUMMARY = {"object": "egg", "outcome": "held", "hold_force_N": 0.6, "hold_force_true_N": None, "sensor": "dense", "seed": 0}


def draw(folder, snapshot):
    report.write_figure(folder / "summary.png", load_recording(folder), snapshot, SUMMARY)
    picture = cv2.imread(str(folder / "summary.png"))
    assert picture.shape[0] > 600 and picture.std() > 10
    assert not list(folder.glob("*.part"))


@pytest.mark.parametrize("break_force", [0.9, 2.5, None])
def test_a_whole_run(tmp_path, break_force):
    cycles = write_fake_recording(tmp_path, count=60)
    recording = load_recording(tmp_path)
    recording.notes["break_force_N"] = break_force
    draw(tmp_path, cycles[40])


def test_a_run_without_a_cycle(tmp_path):
    Recorder(tmp_path, {}).close()
    draw(tmp_path, None)


def test_a_run_that_felt_nothing_known(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        for i in range(3):
            recorder.add(fake_cycle(i, force=np.nan))
    draw(tmp_path, recorder.snapshot)


def test_without_matplotlib_there_is_one_clear_line(tmp_path, monkeypatch):
    write_fake_recording(tmp_path, count=3)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MjtactileError, match=r"pip install 'mjtactile\[plots\]'"):
        report.write_figure(tmp_path / "summary.png", load_recording(tmp_path), None, SUMMARY)


class _Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_in_a_log_file_is_one_line_a_phase():
    stream = io.StringIO()
    progress = Progress(stream)
    for i in range(20):
        progress.update("approach" if i < 10 else "hold", i / 30, 0.5)
    assert [line.split()[0] for line in stream.getvalue().splitlines()] == ["approach", "hold"]


def test_progress_on_a_terminal_is_one_line_rewritten_and_messages_get_their_own():
    stream = _Terminal()
    progress = Progress(stream)
    progress.update("approach", 0.0, np.nan)
    progress.update("hold", 1.0, 0.5)
    progress.message("done")
    text = stream.getvalue()
    assert text.count("\r") == 2 and "force unknown" in text and "0.50 N" in text
    assert text.endswith("\ndone\n")


def test_progress_can_be_silent():
    stream = _Terminal()
    progress = Progress(stream, quiet=True)
    progress.update("hold", 1.0, 0.5)
    progress.message("x")
    progress.close()
    assert stream.getvalue() == ""
