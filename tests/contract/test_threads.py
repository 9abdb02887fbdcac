"""Tests of sensing pipelines in threads and processes: values and errors are the same, and a
blocked pipeline delays no cycle.

Time-outs are far longer than any step takes; no test asserts one.
"""

import json
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile.core import platform_support
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Image
from mjtactile.recording.writer import Recorder
from mjtactile.runtime.grasp import run_grasp
from mjtactile.runtime.perception_threads import Perceivers, default_threads, unknown_touch
from tests.emulated_host import controller_text

ONE_FIXTURE = pytest.mark.xdist_group("grasps in threads")
IMAGE = Image(np.zeros((8, 8), np.uint8), 1.0)
NAMES = "left", "right"
ENDS = """def _lift(observation, command, forces):
    return replace(command, phase="done")


"""


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    """Provide the same grasp in the loop and in two processes, and a replay of the first with a
    thread."""
    folders = [tmp_path_factory.mktemp(name) for name in ("none", "two", "replay")]
    quick = tmp_path_factory.mktemp("quick") / "gentle.py"
    # until the grip has settled
    quick.write_text(controller_text().replace("def _lift(", f"{ENDS}def _lifts("))
    runs = ((0, "sim", "-mesh"), (2, "sim", "-mesh"), (1, f"replay:{folders[0]}", "auto"))
    for folder, (workers, rig, effects) in zip(folders, runs, strict=True):
        scenario = Scenario(
            sensor="paper16", effects=effects, rig=rig, controller=str(quick), seed=21
        )
        with Recorder(folder, {"object": "egg"}) as recorder:
            run_grasp(scenario, [recorder], workers=workers)
    return folders


def log(folder, *, without=lambda key: False):
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    # durations and the time of day may differ
    clocks = ("perception_ms", "unix_time_offset_s")
    return [
        {key: value for key, value in line.items() if key not in clocks and not without(key)}
        for line in lines
    ]


@pytest.mark.slow(10)
@ONE_FIXTURE
def test_a_grasp_is_the_same_with_and_without_processes(grasps):
    none, two, _ = grasps
    first = log(none)
    second = log(two)
    assert sum(any(line.get("touching", [])) for line in first) > 5  # both fingers touch
    assert first == second
    frames = sorted(path.name for path in (none / "frames").iterdir())
    assert all(
        (none / "frames" / name).read_bytes() == (two / "frames" / name).read_bytes()
        for name in frames
    )


@pytest.mark.slow
@ONE_FIXTURE
def test_a_replay_in_a_thread_is_the_same(grasps):
    none, _, replay = grasps
    # a replay has no ground truth
    first, second = (
        log(folder, without=lambda key: key.endswith("_true")) for folder in (none, replay)
    )
    assert [line for line in first if line["kind"] == "cycle"] == [
        line for line in second if line["kind"] == "cycle"
    ]


def pipeline(act):
    return SimpleNamespace(perceive=act)


def estimated(image, now, reading=None):
    return unknown_touch(image, now, "ok")


def test_both_pipelines_run_concurrently():
    meet = threading.Barrier(2, timeout=300)  # each waits for the other

    def act(image, now, reading=None):
        meet.wait()
        return estimated(image, now)

    for threads in (1, 2):
        with Perceivers([pipeline(act), pipeline(act)], NAMES, threads) as both:
            assert [touch.status for touch in both.perceive([IMAGE, IMAGE], 1.0)] == ["ok", "ok"]


@pytest.mark.parametrize("threads", [0, 1, 2])
def test_an_error_keeps_its_class_and_the_next_image_is_evaluated(threads):
    calls = []

    def act(image, now, reading=None):
        calls.append(now)
        if now == 1.0:
            raise ValueError("error of a pipeline")
        return estimated(image, now)

    with Perceivers([pipeline(estimated), pipeline(act)], NAMES, threads) as both:
        with pytest.raises(ValueError, match="error of a pipeline"):
            both.perceive([IMAGE, IMAGE], 1.0)
        assert [touch.status for touch in both.perceive([IMAGE, IMAGE], 2.0)] == [
            "ok",
            "ok",
        ] and calls == [1.0, 2.0]


def test_a_blocked_pipeline_reports_unknown_until_it_answers():
    go = threading.Event()
    answered = threading.Event()
    observed = []

    def blocked(image, now, reading=None):
        observed.append(now)
        assert go.wait(300)
        answered.set()
        return estimated(image, now)

    with Perceivers([pipeline(estimated), pipeline(blocked)], NAMES, 2) as both:
        # the second call does not wait for the blocked pipeline
        for now, timeout in ((1.0, 0.01), (2.0, 1e9)):
            left, right = both.perceive([IMAGE, IMAGE], now, timeout)
            assert left.status == "ok" and right.status == (
                "right sensor: its perception does not answer"
            )
            assert right.time == IMAGE.time and np.isnan(right.force_normal) and not right.touching
        go.set()
        assert answered.wait(300)
        while both.perceive([IMAGE, IMAGE], 3.0)[1].status != "ok":
            pass
        # the blocked pipeline received no image, and no late answer was returned for a new request
        assert observed[:2] == [1.0, 3.0]


def test_threads_are_for_several_cameras_and_free_processors(monkeypatch):
    monkeypatch.setattr(platform_support, "processors", lambda: 1)
    assert default_threads() == 0
    monkeypatch.setattr(platform_support, "processors", lambda: 2)
    assert default_threads() == 2 and default_threads(cameras=1) == 0
    assert default_threads(busy=1) == 0  # one processor for the simulated world, one for the loop
    monkeypatch.setattr(platform_support, "processors", lambda: 3)
    assert default_threads(busy=1) == 2
