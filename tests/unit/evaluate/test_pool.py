"""Tests of the execution of episodes: a cluster writes the same lines as processes, and a failure
is an error of its own episode alone."""

import argparse
import json
import resource
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from mjtactile.commands import arguments
from mjtactile.commands.evaluate import ARGUMENTS
from mjtactile.commands.scenario import scenario_of
from mjtactile.core.errors import DeviceError, InputError, Interrupted, SimulationError
from mjtactile.core.scenario import Scenario
from mjtactile.evaluate import episodes, store
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.evaluate.pool import Pool, Running, _progress
from mjtactile.evaluate.run import evaluate
from tests.emulated import wait_for
from tests.emulated_host import controller_text
from tests.fake_run import fake_cycle

COMMON = dict(scenario=Scenario(effects="-mesh,-pipeline"), count=1, objects=["vial"])


def episode(controller, item, seed, **fields):
    """Return the first episode of an evaluation."""
    return Episode(0, Scenario(object=item, controller=controller, seed=seed, **fields))


@pytest.fixture
def quick(tmp_path):
    path = tmp_path / "quick.py"
    path.write_text(controller_text(hold=0.1))
    return [str(path)]


@pytest.mark.filterwarnings("ignore")  # of the cluster's own
@pytest.mark.slow
def test_a_dask_cluster_writes_the_same_lines(tmp_path, quick):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        summary = evaluate(
            tmp_path / "dask",
            controllers=quick,
            running=Running(backend="dask", scheduler=cluster.scheduler_address),
            **COMMON,
        )
    assert summary["controllers"]["quick"]["held"] == 1
    evaluate(tmp_path / "here", controllers=quick, running=Running(workers=1), **COMMON)
    assert (tmp_path / "dask" / "episodes.jsonl").read_bytes() == (
        tmp_path / "here" / "episodes.jsonl"
    ).read_bytes()


@pytest.mark.parametrize(
    ("pool", "message"),
    [
        ({"backend": "ray"}, "--backend: 'ray' is unknown"),
        ({"scheduler": "tcp://a:1"}, "--scheduler: applies to a cluster"),
        ({"backend": "dask"}, "--backend: the address of the cluster is missing"),
    ],
)
def test_a_bad_pool_is_refused_before_a_folder_is_made(tmp_path, pool, message):
    with pytest.raises(InputError, match=message):
        evaluate(
            tmp_path / "out", controllers=["gentle"], running=Running(workers=1, **pool), **COMMON
        )
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_does_not_answer(monkeypatch):
    monkeypatch.setattr("mjtactile.evaluate.pool._CONNECT_TIME", 0.5)
    pool = Pool("dask", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="--scheduler: no scheduler"), pool.open(1):
        pass


HANGS = "import time\ndef step(observation):\n    time.sleep(1e3)\n"
WAITS = "def step(observation):\n    return observation.command\n"
LEAKS = "# in a world whose chambers leak"
RAISES = "def step(observation):\n    return observation.touch[7]\n"


@pytest.mark.parametrize(
    ("text", "kind", "reason"),
    [
        (HANGS, "hung", "step() did not return within"),
        (RAISES, "raised", "step() raised IndexError: tuple index out of range"),
        (WAITS, "hung", "still in phase 'approach' after 0.5 s"),
        (WAITS + LEAKS, "unsafe", "stopped safely: leak: chamber 0 lost pressure"),
    ],
)
def test_a_controller_that_raises_or_hangs_counts_as_a_failure(
    tmp_path, monkeypatch, text, kind, reason
):
    monkeypatch.setattr("mjtactile.runtime.control_loop.WAIT_TIME", 0.2)
    monkeypatch.setattr("mjtactile.runtime.controller._FIRST_TIME", 0.2)
    path = tmp_path / "bad.py"
    path.write_text(text)
    world = tmp_path / "world.toml"
    leak = 1.0 if text.endswith(LEAKS) else 0.0
    world.write_text(f"[object]\nsize_percent = 5\n[gas]\nleak_mL_s_kPa = {leak}\n")
    # the leak shows in the pressure, which sampled touch has, too
    how = dict(randomization=str(world), time_limit=0.5, effects="-mesh,-pipeline")
    line = run_episode(episode(str(path), "vial", 3, **how))
    assert line["outcome"] == kind and reason in line["reason"] and "\n" not in line["reason"]
    assert (
        line["randomized"]["object.size_percent"]
        and f"--randomization={world}" in line["rerun_command"]
        and json.dumps(line)
    )


def test_failures_to_build_or_run_are_errors(tmp_path, monkeypatch, quick):
    (tmp_path / "huge.toml").write_text("[object]\nsize_percent = 100\nplace_mm = 30\n")
    wide = run_episode(
        replace(
            episode(
                quick[0], "random:3", 3, sensor="paper16", randomization=str(tmp_path / "huge.toml")
            ),
            recording=str(tmp_path / "recordings" / "a"),
        )
    )
    assert not (tmp_path / "recordings" / "a").exists()  # the run did not start
    assert wide["outcome"] == "error" and "touches a sensor before the jaws close" in wide["reason"]
    assert wide["object"] == "random" and wide["randomized"]["random.shape"] == "cylinder"
    monkeypatch.setattr("mjtactile.evaluate.episodes.run_grasp", lambda *_, **__: 1 / 0)
    broken = run_episode(episode(quick[0], "vial", 3))
    assert (
        broken["outcome"] == "error"
        and "ZeroDivisionError" in broken["reason"]
        and "test_pool.py, line" in broken["reason"]
    )


@pytest.mark.parametrize(
    ("rate", "left"), [(1.0, "3600 per hour, 7 s"), (0.01, "36 per hour, 12 min")]
)
def test_progress_prints_the_reason_of_an_error_at_once(rate, left):
    """Seven are left of ten, at `rate` in a second."""
    line = {"controller": "mine", "object": "vial", "seed": 4, "outcome": "error", "reason": "wide"}
    start = "3 of 10: mine, vial, seed 4"
    assert _progress(line, 3, 10, rate) == f"{start}: error (wide); {left} left"
    held = line | {"outcome": "held", "reason": "done"}
    assert _progress(held, 3, 10, rate) == f"{start}: held; {left} left"


def test_a_full_disk_loses_no_stored_line(tmp_path):
    """A file size limit replaces a full disk: a write is incomplete, and resuming continues after
    the complete lines."""
    kept = store.Store(tmp_path / "out", {"options": {}}, resume=False)
    kept.add({"episode": 0, "controller": "a", "outcome": "held"})
    size = (tmp_path / "out" / "episodes.jsonl").stat().st_size
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 10, limits[1]))
    try:
        with pytest.raises(
            DeviceError, match=r"episodes.jsonl: cannot be written: " r".*--resume continues"
        ):
            kept.add({"episode": 1, "controller": "a" * 100})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [
        line["episode"]
        for line in store.Store(tmp_path / "out", {"options": {}}, resume=True).lines
    ] == [0]


def test_an_episode_that_was_terminated_has_no_line(tmp_path, monkeypatch, quick):
    """An interrupted episode has no line: --resume repeats the work of a worker that a cluster
    removed."""

    def interrupted(*_, **__):
        raise Interrupted

    monkeypatch.setattr(episodes, "run_grasp", interrupted)
    with pytest.raises(Interrupted):
        run_episode(episode("gentle", "egg", 0))
    with pytest.raises(DeviceError, match="a worker was stopped; --resume continues"):
        evaluate(tmp_path / "out", controllers=quick, running=Running(workers=1), **COMMON)
    assert store.read_lines(tmp_path / "out") == []


def test_the_manifest_contains_the_command_of_the_evaluation(tmp_path):
    (tmp_path / "a").mkdir()
    for path in (tmp_path / "cup.xml", tmp_path / "a" / "cup.xml"):  # two of one name
        path.write_text(path.parent.name)
    options = {
        "count": 40,
        "controllers": ["gentle", "my own.py"],
        "objects": ["egg", "cup.xml"],
        "shard": [2, 8],
        "scenario": Scenario(sensor="paper16", effects="-images", seed=7, task="pour").to_dict(),
    }
    found = store.manifest(options, [tmp_path / "cup.xml", tmp_path / "a" / "cup.xml"])
    assert len(found["files"]) == 2
    parser = argparse.ArgumentParser()
    arguments.add(parser, ARGUMENTS)
    program, name, *words = shlex.split(found["command"])
    parsed = parser.parse_args(words)
    read = dict(vars(parsed))
    assert (program, name, read["episodes"], read["seed"], read["shard"]) == (
        "mjtactile",
        "evaluate",
        40,
        7,
        (2, 8),
    )
    assert read["controller"] == options["controllers"] and read["objects"] == "egg,cup.xml"
    parsed.controller = None  # there are several
    assert scenario_of(parsed, Scenario(randomization="default")).to_dict() == options["scenario"]


def test_an_object_crushed_before_a_simulation_failure_is_crushed(tmp_path, monkeypatch, quick):
    """Otherwise a controller with excessive force would have uncounted errors in place of
    failures."""

    def presses(scenario, observers, **_):
        for observer in observers:
            observer.note(break_force_N=2.0)
            for force in (0.5, 3.0):
                observer.add(fake_cycle(0), force_normal_true=[force, force])
        raise SimulationError("a membrane is where the model does not hold", step=7, time=0.1)

    monkeypatch.setattr(episodes, "run_grasp", presses)
    line = run_episode(episode(quick[0], "vial", 3))
    assert line["outcome"] == "crushed" and "simulation failed at step 7" in line["reason"]


HOST = """
import os, sys, time
from pathlib import Path
from types import SimpleNamespace
from mjtactile.evaluate.pool import Pool, run_all

def run(folder):
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)

run_all([sys.argv[1]] * 3, SimpleNamespace(add=print), Pool(workers=3), print, run)
"""


def test_the_workers_of_a_killed_evaluation_end(tmp_path):
    """Workers watch their parent: SIGKILL leaves neither processes nor shared memory behind."""
    workers = tmp_path / "workers"
    workers.mkdir()
    host = subprocess.Popen([sys.executable, "-c", HOST, str(workers)], stdout=subprocess.DEVNULL)
    try:
        assert wait_for(lambda: len(list(workers.iterdir())) == 3, 120)
    finally:
        host.kill()
        host.wait()
    pids = [int(item.name) for item in workers.iterdir()]
    assert len(pids) == 3
    assert wait_for(lambda: not any(map(is_running, pids)), 60)
    assert wait_for(lambda: not list(Path("/dev/shm").glob(f"*loky-{host.pid}-*")), 60)


def is_running(pid):
    """Return True for a process that has neither ended nor is a zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"
