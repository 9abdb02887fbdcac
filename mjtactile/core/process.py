"""Child processes of this package: start, communication and termination.

They communicate by lines of JSON and end with their parent. A child is a new interpreter, not a
fork, since this process may have threads. It has one BLAS thread and its own session. Ctrl-C in the
terminal reaches the parent only. The parent ends its children after its shutdown.
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

_PARENT = "MJTACTILE_PARENT"  # environment variable with the parent's process id
# interval of the checks that the parent is alive, s, if the kernel does not report its end
_PARENT_TIME = 1.0
_PARENT_GRACE = 5.0  # time for a child to end by itself after its parent, s
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def start(
    module: str,
    *args: object,
    descriptors: Sequence[int] = (),
    talk: bool = False,
    grace: float = _PARENT_GRACE,
) -> subprocess.Popen[str]:
    """Start `python -m MODULE ARGS` as a child process.

    It inherits these file `descriptors`. With `talk`, its stdin and stdout are pipes for `ask`.
    Otherwise they are the null device. It is ended `grace` s after this process, unless it ends
    earlier.
    """
    home = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    stream = subprocess.PIPE if talk else subprocess.DEVNULL
    code = f"from {__name__} import run; run({grace!r})"
    # -P: a file in the user's folder must not replace a module
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
    """Send a line of text to the child `name` and return its answer, a line of JSON.

    Raises DeviceError when the child has ended, or the error that it reports by a `failure`.
    """
    assert process.stdin and process.stdout
    line = ""
    with contextlib.suppress(OSError, ValueError):  # broken or closed stream: no reply
        process.stdin.write(request + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
    if not line:
        raise DeviceError(
            f"{name} has ended ({how_it_ended(process)}); its output to stderr gives the reason"
        )
    answer = json.loads(line)
    if isinstance(answer, dict) and "error" in answer:
        raise (InputError if answer["exit_code"] == InputError.exit_code else DeviceError)(
            answer["error"]
        )
    return answer


def failure(error: MjtactileError) -> str:
    """Return the answer of a child that failed: a line of JSON."""
    return json.dumps({"error": str(error), "exit_code": error.exit_code})


def how_it_ended(process: subprocess.Popen[str]) -> str:
    """Return the signal or exit code of a process, for a message."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(0.2)  # its pipes and sockets close a moment before it can be waited for
    code = process.poll()
    if code is None:
        return "still running, but not connected"
    return f"by signal {-code}" if code < 0 else f"exit code {code}"


def stop(process: subprocess.Popen[str], timeout: float = 0.0) -> None:
    """End a child: close its stdin, and kill it if it still runs after `timeout` s."""
    if process.stdin:
        with contextlib.suppress(OSError):
            process.stdin.close()
    try:
        process.wait(timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout:
        process.stdout.close()


def run(grace: float) -> None:
    """Run the child's module. Monitoring of the parent starts before any slow step."""
    end_with_parent(grace)
    gc.set_threshold(100_000)  # imports create many objects and free few, see `cli`
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def end_with_parent(grace: float) -> None:
    """End this process at most `grace` s after its parent, and ignore Ctrl-C from now on.

    Pipes and sockets alone are not sufficient. Another process may hold the parent's end, and a
    child that is importing modules does not read them.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    watch_parent(int(os.environ[_PARENT]), grace)


def watch_parent(parent: int, grace: float = 0.0) -> None:
    """End this process at most `grace` s after its parent process with the id `parent`.

    A thread watches it. For processes that another library starts: a killed parent ends no child.
    """

    def outlive() -> None:
        end = platform_support.watch_process(parent)
        ends = [] if end is None else [end]
        while os.getppid() == parent:
            select.select(ends, [], [], _PARENT_TIME)
        time.sleep(grace)
        os._exit(1)

    threading.Thread(target=outlive, name="parent", daemon=True).start()
