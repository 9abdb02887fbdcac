"""Limit on the additional memory of a process while an object is held.

A request beyond the limit fails with a MemoryError that is handled. Without a limit, gigabyte
allocations block all other threads of the interpreter for seconds. Devices then treat the host as
lost. The kernel also kills a process that has used all memory.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path

BYTES_MAX = 512 << 20
"""Bytes that a run may allocate beyond the memory used after a controller's first step. That step
may import modules; a recording is written continuously."""
_STATUS = Path("/proc/self/status")


@contextlib.contextmanager
def limited(maximum: int = BYTES_MAX) -> Iterator[Callable[[], None]]:
    """Limit this process's memory to `maximum` bytes beyond the used ones, on Linux.

    Yield the function that starts the limit on its first call. It has no effect if the system has
    no such limit, or a tighter one.
    """
    try:
        resource = importlib.import_module("resource")
        before = resource.getrlimit(resource.RLIMIT_DATA)
    except (ImportError, AttributeError):
        yield lambda: None
        return

    has_started = False

    def start_limit() -> None:
        nonlocal has_started
        if has_started:
            return
        has_started = True
        used = _used()
        soft, hard = before
        if used is not None and (soft == resource.RLIM_INFINITY or used + maximum < soft):
            resource.setrlimit(resource.RLIMIT_DATA, (used + maximum, hard))

    try:
        yield start_limit
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _used() -> int | None:
    """Return the bytes of writable memory of this process; None if the system does not report
    it."""
    with contextlib.suppress(OSError, ValueError):
        for line in _STATUS.read_text(encoding="ascii").splitlines():
            if line.startswith("VmData:"):
                return int(line.split()[1]) << 10
    return None
