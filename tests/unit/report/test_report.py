"""Tests of the figure and the progress line for every kind of run."""

import io
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from mjtactile.core import process
from mjtactile.core.errors import MjtactileError
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.report import summary_figure as report
from mjtactile.report.figure_process import figure_writer_process
from mjtactile.runtime.progress import Progress
from tests.fake_run import fake_cycle, fake_touch, write_fake_recording


class FakeScene:
    """A triangle and sensors around it."""

    def __init__(self, sensors):
        angle = 2 * np.pi * np.arange(sensors) / sensors
        self.p_WS = 0.03 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sensors)])
        self.R_WS = np.tile(np.eye(3), (sensors, 1, 1))

    def triangles(self):
        return 0.02 * np.eye(3)[None], np.ones((1, 4))


SUMMARY = {
    "object": "egg",
    "outcome": "held",
    "hold_force_N": 0.6,
    "hold_force_true_N": None,
    "sensor": "dense",
    "seed": 0,
}


def render(recording, snapshot, scene=None):
    folder = recording.folder
    report.write_figure(folder / "summary.png", recording, snapshot, SUMMARY, scene)
    image = cv2.imread(str(folder / "summary.png"))
    assert image.shape[0] > 600 and image.std() > 10
    assert not list(folder.glob("*.part"))


@pytest.mark.parametrize(
    ("break_force", "fingers", "scene"), [(0.9, 1, True), (2.5, 2, False), (None, 3, True)]
)
def test_a_run_of_any_number_of_fingers_with_its_scene_and_without(
    tmp_path, break_force, fingers, scene
):
    cycle = write_fake_recording(tmp_path, count=60)[40]
    cycle = replace(cycle, touch=(cycle.touch[0],) * fingers, images=(cycle.images[0],) * fingers)
    recording = load_recording(tmp_path)
    recording.notes["break_force_N"] = break_force
    render(recording, cycle, FakeScene(fingers) if scene else None)


def test_a_run_without_a_cycle(tmp_path):
    Recorder(tmp_path, {}).close()
    render(load_recording(tmp_path), None)


@pytest.mark.parametrize("alive", [True, False])
def test_a_render_process_gives_the_same_images_and_may_end(tmp_path, monkeypatch, alive):
    monkeypatch.setenv("PYTHON_CPU_COUNT", "2")
    cycles = write_fake_recording(tmp_path, count=20)
    shots = []
    with figure_writer_process() as beside:
        if not alive:
            beside._worker._process.kill()
        for write in (report.write_figure, beside):
            write(
                tmp_path / "summary.png",
                load_recording(tmp_path),
                cycles[10],
                SUMMARY,
                FakeScene(1),
            )
            shots.append((tmp_path / "summary.png").read_bytes())
            (tmp_path / "summary.png").unlink()
    assert shots[0] == shots[1]


def test_without_memory_for_a_process_the_report_is_rendered_in_process(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise BlockingIOError("no more processes")

    write_fake_recording(tmp_path, count=3)
    monkeypatch.setenv("PYTHON_CPU_COUNT", "2")
    monkeypatch.setattr(process, "start", refuse)
    with figure_writer_process() as beside:
        beside(tmp_path / "summary.png", load_recording(tmp_path), None, SUMMARY)
    assert (tmp_path / "summary.png").exists()


def test_with_one_processor_no_render_process_starts(monkeypatch):
    monkeypatch.setenv("PYTHON_CPU_COUNT", "1")
    monkeypatch.setattr(process, "start", None)  # would raise
    with figure_writer_process() as beside:
        assert beside._worker is None


def test_an_error_of_the_render_process_is_reported(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHON_CPU_COUNT", "2")
    write_fake_recording(tmp_path, count=3)
    with figure_writer_process() as beside, pytest.raises(FileNotFoundError, match="no/such"):
        beside(tmp_path / "no/such/summary.png", load_recording(tmp_path), None, SUMMARY)


def test_arrows_are_drawn_at_contacts_only_with_a_round_scale():
    touch = fake_touch(0.6, 0.0)
    stress = report._tractions(touch)
    assert np.array_equal(np.linalg.norm(stress, axis=-1) > 0, touch.contact.mask)
    area = (touch.traction.x[1] - touch.traction.x[0]) * (touch.traction.y[1] - touch.traction.y[0])
    inside = touch.traction.force[touch.contact.mask].sum(axis=0)
    np.testing.assert_allclose(stress.sum(axis=(0, 1)) * area, inside, rtol=1e-9)
    largest = np.linalg.norm(stress, axis=-1).max()
    assert 0.4 * largest < report.arrow_unit([touch]) <= largest
    assert not report._tractions(replace(touch, touching=False)).any()
    # without contact: a scale, too
    assert report.arrow_unit([fake_touch(0.0, 0.0)]) == 1000.0


def test_a_run_without_known_estimates(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        for i in range(3):
            recorder.add(fake_cycle(i, force=np.nan))
    render(load_recording(tmp_path), recorder.snapshot)


def test_without_matplotlib_one_line_names_the_package(tmp_path, monkeypatch):
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
