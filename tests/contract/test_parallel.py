"""A sensing chain in a process of its own: the same numbers, the same errors, and no process left behind.

Time-outs are far beyond what anything takes; none is asserted.
"""

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image, Touch
from mjtactile.recording.writer import Recorder
from mjtactile.run import workers as perception
from mjtactile.run.grasp import GraspOptions, run_grasp
from mjtactile.run.workers import RemotePerception, Workers, default_workers, perceive
from mjtactile.sensing.chain import Perception
from mjtactile.sim.picture.renderer import Renderer
from tests.emulated import wait_for
from tests.emulated_host import controller_text

DESIGN = load_sensor("paper16")
NAMES = ("left", "right")
WAIT = 120  # s on a busy computer

one_thread = pytest.mark.skipif(os.environ.get("OPENBLAS_NUM_THREADS") != "1",
                                reason="more BLAS threads round otherwise; make and the command line set one")


def bulge(height):
    """Markers of a membrane bulged by `height` m, with its outward normals: no physics needed, but 35 um from a real bulge."""
    x, y = DESIGN.markers.p_SM[:, 0] / (DESIGN.frame.length / 2), DESIGN.markers.p_SM[:, 1] / (DESIGN.frame.width / 2)
    a, b, flatter = 1 - x**2, 1 - y**2, 1 + 0.25 * x**2 + 0.15 * y**2
    p_SM = np.column_stack([DESIGN.markers.p_SM[:, :2], height * a * b * flatter])
    slope = np.column_stack([b * (0.5 * x * a - 2 * x * flatter) / (DESIGN.frame.length / 2),
                             a * (0.3 * y * b - 2 * y * flatter) / (DESIGN.frame.width / 2)])
    n_S = np.column_stack([-height * slope, np.ones(len(p_SM))])
    return p_SM, n_S / np.linalg.norm(n_S, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def images():
    """Flat, at rest, and a little pressed in, three images each."""
    renderer = Renderer(DESIGN, seed=3)
    return {name: [renderer.render(*bulge(height), time=0.1 * i) for i in range(3)]
            for name, height in (("flat", 0.0), ("rest", 2.0e-3), ("pressed", 1.7e-3))}


@pytest.fixture(scope="module")
def workers():
    with Workers(2) as workers:
        yield workers


def referenced(chain, images):
    chain.take_flat(images["flat"])
    chain.take_rest(images["rest"], 1000.0)
    return chain


def values(value):
    """Every number and word in a value, arrays as bytes: equal lists are the same bit for bit."""
    if isinstance(value, np.ndarray):
        return [value.dtype.str, value.shape, value.tobytes()]
    if isinstance(value, tuple):
        return [values(item) for item in value]
    if hasattr(value, "__dataclass_fields__"):
        return [type(value).__name__, *(values(getattr(value, name)) for name in value.__dataclass_fields__)]
    return repr(value)


# -- the same numbers --------------------------------------------------------------------------------------------------

@one_thread
def test_touch_is_the_same_bit_for_bit(workers, images):
    here = [referenced(Perception.of(DESIGN), images) for _ in NAMES]
    there = [referenced(chain, images) for chain in workers.perceptions(dict.fromkeys(NAMES, DESIGN))]
    assert all(isinstance(chain, RemotePerception) for chain in there)
    for left, right in zip(images["rest"], images["pressed"], strict=True):
        ours, theirs = perceive(here, (left, right), 0.5), perceive(there, (left, right), 0.5)
        assert values(ours) == values(theirs)
        assert all(isinstance(touch, Touch) and touch.status == "ok" for touch in theirs)
    assert theirs[1].surface is not None and theirs[1].markers is not None
    with pytest.raises(ValueError, match="read-only"):
        theirs[1].surface.z[0, 0] = 1.0


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    """The same grasp with the chains in this process and in others; then the first one's replay with one in another."""
    folders = [tmp_path_factory.mktemp(name) for name in ("here", "there", "replay")]
    quick = tmp_path_factory.mktemp("quick") / "gentle.py"
    quick.write_text(controller_text(hold=0.1))
    for folder, workers, rig in zip(folders, (0, 2, 1), ("sim", "sim", f"replay:{folders[0]}"), strict=True):
        options = GraspOptions(sensor="paper16", rig=rig, controller=str(quick), seed=21, workers=workers)
        with Recorder(folder, {"object": "egg"}) as recorder:
            run_grasp(options, recorder=recorder, progress=Silent())
    return folders


class Silent:
    def message(self, text):
        pass

    def update(self, phase, time, force):
        pass


def log(folder, *, leave_out):
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if key not in leave_out} for line in lines]


@one_thread
def test_a_grasp_is_the_same_with_and_without_workers(grasps):
    here, there, _ = grasps
    first, second = (log(folder, leave_out=("perception_ms",)) for folder in (here, there))  # how long it took may differ
    assert sum(any(line.get("touching", [])) for line in first) > 50  # it is a grasp
    assert first == second
    frames = sorted(path.name for path in (here / "frames").iterdir())
    assert all((here / "frames" / name).read_bytes() == (there / "frames" / name).read_bytes() for name in frames)


@one_thread
def test_a_replay_in_another_process_is_the_same(grasps):
    here, _, replay = grasps
    first, second = (log(folder, leave_out=("perception_ms",)) for folder in (here, replay))
    first, second = ([{key: value for key, value in line.items() if not key.endswith("_true")}  # a replay has no truth
                      for line in lines if line["kind"] == "cycle"] for lines in (first, second))
    assert first == second


# -- errors -------------------------------------------------------------------------------------------------------------

def outcome(action):
    try:
        return values(action())
    except Exception as error:  # noqa: BLE001  # whatever it is, the other one must raise it too
        return type(error), str(error)


def test_errors_of_the_chain_arrive_as_themselves(workers, images):
    blank = Image(np.full((DESIGN.camera.height, DESIGN.camera.width), 128, np.uint8))
    small = Image(np.full((10, 12), 128, np.uint8))
    here, there = Perception.of(DESIGN), workers.perceptions({NAMES[0]: DESIGN})[0]
    assert outcome(lambda: there.perceive(blank, 0.0)) == outcome(lambda: here.perceive(blank, 0.0))
    assert outcome(lambda: there.take_flat([blank])) == outcome(lambda: here.take_flat([blank]))
    with pytest.raises(DeviceError, match="flat reference: only 0 of 16 markers") as caught:
        there.take_flat([blank])
    assert "in a perception process" in caught.value.__notes__[0]
    referenced(here, images)
    referenced(there, images)
    assert outcome(lambda: there.perceive(small, 0.0)) == outcome(lambda: here.perceive(small, 0.0))
    assert there.perceive(images["rest"][0], 0.0).status == "ok"  # and it goes on


def test_an_error_that_cannot_travel_is_named():
    class Odd(Exception):  # a local class does not pickle
        pass

    portable = perception._portable(Odd("what it says"))
    assert type(portable) is RuntimeError and str(portable) == "Odd: what it says"


def test_a_worker_that_dies_is_a_fault_of_its_sensor(images):
    with Workers(2) as workers:
        chains = [referenced(chain, images) for chain in workers.perceptions(dict.fromkeys(NAMES, DESIGN))]
        pair = images["rest"][:2]
        perceive(chains, pair, 0.0)
        os.kill(workers.pids[1], signal.SIGKILL)
        for _ in range(3):
            with pytest.raises(DeviceError, match=r"right sensor: its perception process ended \(by signal 9\)"):
                perceive(chains, pair, 0.0)
        assert chains[0].perceive(pair[0], 0.0).status == "ok"  # the other one's late answers are not taken for new ones


def test_a_worker_that_hangs_is_a_fault_of_its_sensor(images, monkeypatch):
    monkeypatch.setattr(perception, "REPLY_TIME", 1)
    with Workers(1) as workers:
        chain = referenced(workers.perceptions({NAMES[0]: DESIGN})[0], images)
        late, now = images["rest"][0], images["rest"][1]
        os.kill(workers.pids[0], signal.SIGSTOP)
        for patience in (0.1, 1e9):  # in the loop: not waited for again before it has answered
            (touch,) = perceive([chain], [late], 0.0, patience)
            assert touch.status == "left sensor: its perception process does not answer"
            assert touch.time == late.time and np.isnan(touch.force_normal) and not touch.touching
        os.kill(workers.pids[0], signal.SIGCONT)
        deadline = time.monotonic() + WAIT
        while time.monotonic() < deadline:
            touch = chain.perceive(now, 0.1)
            assert touch.time == now.time  # not the answer to an image before
            if touch.status == "ok":
                break
        assert touch.status == "ok"
        os.kill(workers.pids[0], signal.SIGSTOP)
        with pytest.raises(DeviceError, match="left sensor: its perception process did not answer for 1 s"):
            chain.take_flat(images["flat"])  # while references are taken


def test_a_worker_that_stops_in_the_middle_of_an_answer(monkeypatch):
    monkeypatch.setattr(perception, "REPLY_TIME", 1)
    with Workers(1) as workers:
        chain = workers.perceptions({NAMES[0]: DESIGN})[0]
        chain._settle()
        ours, theirs = socket.socketpair()
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 1, 0))
        kept, chain._worker.connection, chain._due = chain._worker.connection, Connection(ours.detach()), 1
        theirs.send(struct.pack("!i", 100) + b"not a hundred")
        with pytest.raises(DeviceError, match="did not answer"):
            chain._settle()
        kept.close()
        theirs.close()


# -- processes ----------------------------------------------------------------------------------------------------------

def test_a_worker_has_one_blas_thread_and_no_ear_for_ctrl_c(workers, images):
    chain = workers.perceptions({NAMES[0]: DESIGN})[0]
    with pytest.raises(DeviceError, match="before the references"):
        chain.perceive(images["flat"][0], 0.0)  # it runs by now
    environment = Path(f"/proc/{workers.pids[0]}/environ").read_bytes().split(b"\0")
    assert {b"OPENBLAS_NUM_THREADS=1", b"OMP_NUM_THREADS=1"} <= set(environment)
    os.kill(workers.pids[0], signal.SIGINT)
    referenced(chain, images)


def is_alive(pid):
    """Whether a process runs; one that only waits to be reaped does not."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def children(pid):
    """Its worker processes."""
    pids = [int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()]
    return [child for child in pids if b"mjtactile.run.workers" in Path(f"/proc/{child}/cmdline").read_bytes()]


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("cycles", [0, 3], ids=["starting", "running"])
def test_no_process_outlives_its_host(tmp_path, stop, cycles):
    host = subprocess.Popen([sys.executable, "-m", "mjtactile", "grasp", "--workers", "2", "--sensor", "paper16", "--out", "out"],
                            cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        log = tmp_path / "out" / "recording" / "log.jsonl"
        assert wait_for(lambda: len(children(host.pid)) == 2 and log.read_text().count('"cycle"') >= cycles, WAIT), host.poll()
        pids = children(host.pid)
    finally:
        host.send_signal(stop)
        host.wait(WAIT)
    assert wait_for(lambda: not any(map(is_alive, pids)), WAIT)


def test_a_worker_ends_with_its_parent_even_if_another_process_holds_its_socket(tmp_path):
    code = """if True:
        import subprocess, time
        from mjtactile.run.workers import Workers
        workers = Workers(1)
        sleeper = subprocess.Popen(["sleep", "300"], stdout=subprocess.DEVNULL,
                                   pass_fds=[workers._workers[0].connection.fileno()])
        print(workers.pids[0], sleeper.pid, flush=True)
        time.sleep(300)
    """
    host = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    worker, sleeper = map(int, host.stdout.readline().split())
    try:
        assert is_alive(worker)
        host.kill()
        host.wait(WAIT)
        assert wait_for(lambda: not is_alive(worker), WAIT)
        assert is_alive(sleeper)  # which had kept the socket open
    finally:
        os.kill(sleeper, signal.SIGKILL)
        host.communicate()


def test_workers_are_for_two_cameras_and_two_processors(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert default_workers() == 0
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    assert default_workers() > 0 and default_workers(cameras=1) == 0
