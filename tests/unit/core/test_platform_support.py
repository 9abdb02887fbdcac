"""Tests without each optional feature of a system: its replacement gives the same results."""

import os
import select
import subprocess
import sys

import pytest

from mjtactile.core import platform_support, process
from mjtactile.emulator.shared_memory import SharedState

WINDOWS = """if True:
    import signal, sys
    sys.platform = "win32"
    del signal.SIGHUP, signal.SIGQUIT
    sys.modules.update(dict.fromkeys(("fcntl", "pty", "termios", "tty")))
"""


def without(name, monkeypatch):
    monkeypatch.delattr(os, name, raising=False)


@pytest.fixture
def all_processors(monkeypatch):
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)


@pytest.mark.parametrize(("given", "expected"), [("3", 3), ("1", 1), ("", 6), ("0", 6), ("two", 6)])
def test_processors_of_the_environment_variable(monkeypatch, given, expected):
    """As in Python 3.13; another text is ignored."""
    without("sched_getaffinity", monkeypatch)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    monkeypatch.setenv("PYTHON_CPU_COUNT", given)
    assert platform_support.processors() == expected


def test_processors_of_the_process_affinity(all_processors):
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert platform_support.processors() == allowed


@pytest.mark.parametrize(("there", "expected"), [(6, 6), (None, 1)])
def test_processors_without_a_reported_affinity(monkeypatch, all_processors, there, expected):
    without("sched_getaffinity", monkeypatch)
    monkeypatch.setattr(os, "cpu_count", lambda: there)
    assert platform_support.processors() == expected


@pytest.mark.parametrize("has_it", [True, False])
def test_memory_is_shared_through_a_descriptor(monkeypatch, has_it):
    if not has_it:
        without("memfd_create", monkeypatch)
    descriptor = platform_support.memory_file("test")
    shared = SharedState(descriptor, ["opening"])
    shared["opening"] = 0.08
    code = f"""if True:
        from mjtactile.emulator.shared_memory import SharedState
        state = SharedState({descriptor}, ["opening"])
        print(state["opening"])
        state["opening"] = 0.02
    """
    child = subprocess.run(
        [sys.executable, "-c", code], pass_fds=[descriptor], capture_output=True, check=True
    )
    assert child.stdout == b"0.08\n"
    assert shared["opening"] == 0.02
    shared.close()
    os.close(descriptor)


def test_a_process_end_has_a_descriptor_where_supported(monkeypatch):
    child = subprocess.Popen(["sleep", "300"])
    end = platform_support.watch_process(child.pid)
    if end is not None:
        assert not select.select([end], [], [], 0)[0]
    child.kill()
    child.wait()
    if end is not None:
        assert select.select([end], [], [], 10)[0]
        os.close(end)
    assert (
        platform_support.watch_process(child.pid) is None
    )  # ended: there is no such process any more
    without("pidfd_open", monkeypatch)
    assert platform_support.watch_process(os.getpid()) is None


def test_a_child_ends_with_its_parent_where_its_end_is_not_reported():
    """The child checks for its parent once a second."""
    code = f"""if True:
        import os, subprocess, sys
        from {process.__name__} import _PARENT
        code = "import os, time; " \\
            "vars(os).pop('pidfd_open', None); " \\
            "from mjtactile.core.process import end_with_parent; end_with_parent(0.0); " \\
            "print('here', flush=True); time.sleep(300)"
        child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE,
                                 env={{**os.environ, _PARENT: str(os.getpid())}})
        child.stdout.readline()
        os.write(1, b"here\\n")
        sys.stdin.readline()
    """
    read_end, write_end = os.pipe()  # the child keeps its writing end open until its end
    os.set_inheritable(write_end, True)
    parent = subprocess.Popen(
        [sys.executable, "-c", code.replace("env=", f"pass_fds=[{write_end}], env=")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=[write_end],
    )
    os.close(write_end)
    assert parent.stdout.readline() == b"here\n"
    assert not select.select([read_end], [], [], 0)[0]
    parent.kill()
    parent.communicate()
    assert select.select([read_end], [], [], 30)[0]
    os.close(read_end)


@pytest.mark.parametrize(
    ("code", "exit_code"),
    [
        ("import mjtactile.cli; sys.exit(mjtactile.cli.main(['grasp']))", 2),
        ("from mjtactile import load_sensor", 1),
        ("from mjtactile.kernels import kernel; kernel('circles_on_cones')", 1),
    ],
    ids=["command", "Python", "kernels"],
)
def test_windows_is_refused_in_one_line(code, exit_code):
    run = subprocess.run(
        [sys.executable, "-c", WINDOWS + f"    {code}\n"],
        capture_output=True,
        text=True,
        check=False,
    )
    lines = run.stderr.splitlines()
    assert "mjtactile runs on Linux and macOS; on Windows, inside WSL" in lines[-1]
    assert run.returncode == exit_code
    assert exit_code == 1 or len(lines) == 1
