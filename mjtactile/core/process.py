"""Child processes of this package: started alike, spoken to by lines of JSON, and gone when their
parent is.

A child is a new interpreter, not a fork (this one may have threads), with one BLAS thread, in a
session of its own: Ctrl-C in the terminal is for the parent, which ends its children when it has
shut down.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import runpy
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mjtactile.core import platform_support
from mjtactile.core.errors import DeviceError, InputError, MjtactileError

_PARENT = "MJTACTILE_PARENT"  # the environment variable that tells a child whose it is
# s between two looks whether the parent still lives, where the kernel does not tell of its end
_PARENT_TIME = 1.0
_PARENT_GRACE = 5.0  # s for a child to end by itself when its parent is gone
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def start(
    module: str,
    *args: object,
    descriptors: Sequence[int] = (),
    talk: bool = False,
    grace: float = _PARENT_GRACE,
) -> subprocess.Popen[str]:
    """Start `python -m MODULE ARGS`, which keeps these file `descriptors`; with `talk`, its stdin
    and stdout are pipes for `ask`, else there are none. It is ended `grace` s after this process,
    if it does not end by itself."""
    home = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    stream = subprocess.PIPE if talk else subprocess.DEVNULL
    code = f"from {__name__} import run; run({grace!r})"
    # -P: a file of the user's folder must not stand in for a module
    return subprocess.Popen(
        [sys.executable, "-P", "-c", code, module, *map(str, args)],
        text=True,
        stdin=stream,
        stdout=stream,
        start_new_session=True,
        pass_fds=descriptors,
        env={**os.environ, **_ONE_THREAD, "PYTHONPATH": path, _PARENT: str(os.getpid())},
    )


def ask(process: subprocess.Popen[str], request: str, name: str) -> Any:
    """What the child `name` answers, a line of JSON, to a line of text.

    Raises DeviceError when it has ended, and what it failed with when it answers with a `failure`.
    """
    assert process.stdin and process.stdout
    line = ""
    with contextlib.suppress(OSError, ValueError):  # broken or closed: there is no answer
        process.stdin.write(request + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
    if not line:
        raise DeviceError(
            f"{name} has ended ({how_it_ended(process)}); what it printed to stderr says why"
        )
    answer = json.loads(line)
    if isinstance(answer, dict) and "error" in answer:
        raise (InputError if answer["exit_code"] == InputError.exit_code else DeviceError)(
            answer["error"]
        )
    return answer


def failure(error: MjtactileError) -> str:
    """The line with which a child answers that it failed."""
    return json.dumps({"error": str(error), "exit_code": error.exit_code})


def how_it_ended(process: subprocess.Popen[str]) -> str:
    """By which signal or exit code, for a message."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(0.2)  # its pipes and sockets close a moment before it can be waited for
    code = process.poll()
    if code is None:
        return "it runs, but is not connected"
    return f"by signal {-code}" if code < 0 else f"exit code {code}"


def stop(process: subprocess.Popen[str], disk_wait_time: float = 0.0) -> None:
    """End a child: its stdin closes, and what still runs `patience` s later is killed."""
    if process.stdin:
        with contextlib.suppress(OSError):
            process.stdin.close()
    try:
        process.wait(disk_wait_time)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout:
        process.stdout.close()


def run(grace: float) -> None:
    """What a child does first and last: watch its parent, before anything that takes time, then run
    its module."""
    end_with_parent(grace)
    gc.set_threshold(100_000)  # imports make much and leave nothing: as `cli` has it
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def end_with_parent(grace: float) -> None:
    """From now on this process does not outlive its parent by more than `grace` s, however that
    ends, and no Ctrl-C is for it.

    Pipes and sockets alone do not tell (another process may hold the parent's end), nor to one that
    is busy importing.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = int(os.environ[_PARENT])

    def outlive() -> None:
        end = platform_support.watch_process(parent)
        ends = [] if end is None else [end]
        while os.getppid() == parent:
            select.select(ends, [], [], _PARENT_TIME)
        time.sleep(grace)
        os._exit(1)

    threading.Thread(target=outlive, name="parent", daemon=True).start()
