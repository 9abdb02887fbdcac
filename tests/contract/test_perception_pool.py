"""Tests of sensing pipelines in processes next to a simulated world: errors are the same, a blocked
pipeline delays no cycle, and a lost process is reported.

Time-outs are far longer than any step takes; no test asserts one.
"""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from mjtactile.core import platform_support, process
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Image, Markers, Touch
from mjtactile.recording.observer import Observer
from mjtactile.recording.writer import Recorder
from mjtactile.runtime.grasp import run_grasp
from mjtactile.runtime.perception_processes import PerceptionPool, default_count
from mjtactile.runtime.session import open_session
from tests.emulated_host import controller_text

IMAGE = Image(np.arange(64, dtype=np.uint8).reshape(8, 8), 1.0)
NAMES = "left", "right"


class CountingPipeline:
    """Stand-in for a pipeline: counts its calls and returns its input."""

    def __init__(self):
        self.state = 0

    def perceive(self, image, now, reading=None):
        self.state += 1
        p = np.full((1, 3), float(image.pixels.sum()))
        markers = Markers(np.array([self.state]), p, p, np.ones((1, 3, 3)))
        return Touch(image.time, now - image.time, 0.5, 0.01, True, markers=markers)


class FailingPipeline(CountingPipeline):
    def perceive(self, image, now, reading=None):
        if now == 1.0:
            raise ValueError("error of a pipeline")
        return super().perceive(image, now)


class BlockedPipeline(CountingPipeline):
    def __init__(self, until):
        super().__init__()
        self.until = until

    def perceive(self, image, now, reading=None):
        while not self.until.exists():
            time.sleep(0.01)
        return super().perceive(image, now)


WITH_ONE_OR_TWO_PROCESSES = pytest.mark.parametrize("pool", [1, 2], indirect=True)


@pytest.fixture
def pool(request):
    """Provide two processes, or the parametrized number."""
    processes = PerceptionPool(getattr(request, "param", 2))
    yield processes
    processes.close()


def children():
    return [
        int(pid)
        for task in Path("/proc/self/task").iterdir()
        for pid in (task / "children").read_text().split()
    ]


@WITH_ONE_OR_TWO_PROCESSES
def test_estimates_and_states_are_complete_and_read_only(pool):
    pipelines = [CountingPipeline(), CountingPipeline()]
    for now in (1.5, 2.5):  # two runs: the second continues from the state of the first
        with pool.using(pipelines, NAMES) as both:
            left, right = both.perceive([IMAGE, Image(IMAGE.pixels + np.uint8(1), 1.0)], now)
        assert (left.age, left.force_normal, left.status) == (now - 1, 0.5, "ok")
        assert left.markers.p_SM.tolist() == [[2016.0] * 3] and right.markers.p_SM.tolist() == [
            [2080.0] * 3
        ]
        arrays = [value for value in vars(left.markers).values() if value is not None]
        assert len(arrays) >= 4 and not any(array.flags.writeable for array in arrays)
    assert [pipeline.state for pipeline in pipelines] == [2, 2]


@WITH_ONE_OR_TWO_PROCESSES
def test_an_error_keeps_its_class_and_the_next_image_is_evaluated(pool):
    with pool.using([CountingPipeline(), FailingPipeline()], NAMES) as both:
        with pytest.raises(ValueError, match="error of a pipeline"):
            both.perceive([IMAGE, IMAGE], 1.0)
        left, right = both.perceive([IMAGE, IMAGE], 2.0)
        assert (left.markers.ids, right.markers.ids) == (2, 1)


@pytest.mark.slow
def test_a_blocked_pipeline_reports_unknown_until_it_answers(tmp_path):
    until = tmp_path / "go"
    pool = PerceptionPool(2)
    try:
        with pool.using([CountingPipeline(), BlockedPipeline(until)], NAMES) as both:
            # the second call does not wait for the blocked pipeline
            for now, timeout in ((1.0, 3.0), (2.0, 1e9)):
                left, right = both.perceive([IMAGE, IMAGE], now, timeout)
                assert left.status == "ok" and right.status == (
                    "right sensor: its perception does not answer"
                )
                assert np.isnan(right.force_normal)
            until.touch()
            while (right := both.perceive([IMAGE, IMAGE], 3.0)[1]).status != "ok":
                pass
            # no late answer was returned for a new request
            assert right.markers.ids == 2 and right.age == 2.0
    finally:
        pool.close()


def test_a_stopped_process_delays_no_cycle_and_continues_later(pool):
    with pool.using([CountingPipeline(), CountingPipeline()], NAMES) as both:
        pids = children()
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        assert all(
            np.isnan(touch.force_normal) for touch in both.perceive([IMAGE, IMAGE], 1.0, 0.1)
        )
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
        while any(np.isnan(touch.force_normal) for touch in both.perceive([IMAGE, IMAGE], 2.0)):
            pass


def test_a_killed_process_is_reported_and_its_pipelines_are_unchanged(pool):
    pipelines = [CountingPipeline(), CountingPipeline()]
    with pool.using(pipelines, NAMES) as both:
        both.perceive([IMAGE, IMAGE], 1.0)
        for pid in children():
            os.kill(pid, signal.SIGKILL)
        with pytest.raises(
            DeviceError, match="a process that runs perception has ended \\(by signal 9\\)"
        ):
            both.perceive([IMAGE, IMAGE], 2.0)
    assert [pipeline.state for pipeline in pipelines] == [0, 0]


class ProcessKiller(Observer):
    """Observer that kills the child processes in the first cycle that holds the object in the
    air."""

    def __init__(self):
        self.phases = []

    def add(self, cycle, view=None, **truth):
        phase = cycle.sent.phase
        if phase == "hold" and "hold" not in self.phases:
            for pid in children():
                os.kill(pid, signal.SIGKILL)
        self.phases.append(phase)


@pytest.mark.slow
def test_a_grasp_whose_process_is_killed_sets_down_and_reports_why(tmp_path):
    (tmp_path / "quick.py").write_text(controller_text(hold=0.2))
    scenario = Scenario(
        sensor="paper16", seed=21, effects="-images", controller=str(tmp_path / "quick.py")
    )
    killer = ProcessKiller()
    with (
        Recorder(tmp_path, {"object": "egg"}) as recorder,
        pytest.raises(
            DeviceError,
            match="stopped safely: a process that runs perception has ended \\(by signal 9\\)",
        ),
    ):
        run_grasp(scenario, [recorder, killer], workers=1)
    assert killer.phases.count("hold") > 1  # the loop continued: it set down and opened
    assert children() == []


def test_if_a_process_cannot_start_the_pool_is_closed_and_a_session_uses_none(monkeypatch):
    started = []
    start = process.start

    def refuse_the_second(*args, **kwargs):
        if started:
            raise BlockingIOError("no more processes")
        started.append(start(*args, **kwargs))
        return started[0]

    monkeypatch.setattr(process, "start", refuse_the_second)
    with pytest.raises(BlockingIOError):
        PerceptionPool(2)
    assert started[0].poll() is not None
    with open_session("sim", load_sensor("paper16"), workers=2) as session:
        assert children() == [] and len(session.perceptions) == 2


def test_default_count_is_bounded_by_cameras_and_processors(monkeypatch):
    for processors, expected in ((1, 0), (2, 1), (3, 2), (8, 2)):
        monkeypatch.setattr(platform_support, "processors", lambda n=processors: n)
        assert default_count(2) == expected
