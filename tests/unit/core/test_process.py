"""Tests of child processes: a child answers, names its failures, and ends with its parent, even if
other processes hold the parent's end of its pipes."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from mjtactile.core import process
from mjtactile.core.errors import DeviceError, InputError
from tests.emulated import wait_for

CHILD = """
    import json, os, sys
    from mjtactile.core import process
    from mjtactile.core.errors import DeviceError, InputError
    for line in sys.stdin:
        word = line.strip()
        if word == "fault":
            print(process.failure(DeviceError("cable")), flush=True)
        elif word == "typo":
            print(process.failure(InputError("unknown", field="word")), flush=True)
        elif word == "exit":
            sys.exit(4)
        else:
            print(json.dumps([word, sys.argv[1:], os.environ["OMP_NUM_THREADS"]]), flush=True)
"""
# time-out for the start or end of a process on a busy computer, s; the child has 5 s after its
# parent's end
WAIT = 20.0


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "a_child.py").write_text(textwrap.dedent(CHILD))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "a_child"


@pytest.fixture
def child(module):
    child = process.start(module, 1, "two", talk=True)
    yield child
    process.stop(child)


def is_alive(pid):
    """Return True if a process runs; a zombie does not count."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def test_a_child_answers_in_json_and_has_a_single_thread(child):
    assert process.ask(child, "hello", "the child") == ["hello", ["1", "two"], "1"]


def test_a_failure_is_raised_here_with_its_class(child):
    with pytest.raises(DeviceError, match=r"^cable$"):
        process.ask(child, "fault", "the child")
    with pytest.raises(InputError, match=r"^word: unknown$"):
        process.ask(child, "typo", "the child")
    assert process.ask(child, "and on", "the child")[0] == "and on"


def test_a_child_that_ends_reports_how(child):
    with pytest.raises(DeviceError, match=r"the child has ended \(exit code 4\)"):
        process.ask(child, "exit", "the child")
    with pytest.raises(DeviceError, match=r"the child has ended \(exit code 4\)"):
        process.ask(child, "hello", "the child")


def test_ctrl_c_does_not_reach_a_child_and_stop_ends_it(child):
    process.ask(child, "hello", "the child")
    os.kill(child.pid, signal.SIGINT)
    assert process.ask(child, "again", "the child")[0] == "again"
    child.send_signal(signal.SIGSTOP)  # it receives no end of its stdin
    process.stop(child, 0.1)
    assert process.how_it_ended(child) == "by signal 9"


def test_a_child_ends_with_a_parent_that_is_killed_even_if_another_process_holds_its_pipe(module):
    code = f"""if True:
        import subprocess, sys, time
        from mjtactile.core import process
        child = process.start("{module}", talk=True, grace=0.2)
        process.ask(child, "hello", "the child")
        holder = subprocess.Popen(["sleep", "300"], pass_fds=[child.stdin.fileno()], stdout=subprocess.DEVNULL)
        print(child.pid, holder.pid, flush=True)
        time.sleep(300)
    """
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child, holder = map(int, parent.stdout.readline().split())
    try:
        parent.kill()
        parent.wait(WAIT)
        assert wait_for(lambda: not is_alive(child), WAIT)
        assert is_alive(holder)
    finally:
        os.kill(holder, signal.SIGKILL)
        parent.communicate()


def test_a_child_that_is_still_importing_ends_with_its_parent(tmp_path, monkeypatch):
    (tmp_path / "a_slow_child.py").write_text(
        "import pathlib, time\n"
        "pathlib.Path(__file__).with_suffix('.here').touch()\ntime.sleep(300)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code = """if True:
        import time
        from mjtactile.core import process
        print(process.start("a_slow_child", grace=0.0).pid, flush=True)
        time.sleep(300)
    """
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    try:
        assert wait_for((tmp_path / "a_slow_child.here").exists, WAIT)
    finally:
        parent.kill()
        parent.communicate()
    assert wait_for(lambda: not is_alive(child), WAIT)
