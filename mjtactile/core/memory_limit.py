"""How much more memory a process may take while something is held: whoever asks for more is refused
at once, with a MemoryError that is handled, in place of a computer that stands still.

Handing out gigabytes takes seconds in which no other thread of the interpreter runs, so that
devices take the host for dead; and the kernel ends a process that has used all memory up.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path

MOST = 512 << 20
"""Bytes that a run may take beyond what its process has after a controller's first step, which may
import; a recording is written as it grows."""
_STATUS = Path("/proc/self/status")


@contextlib.contextmanager
def limited(most: int = MOST) -> Iterator[Callable[[], None]]:
    """Limit this process's memory from a moment within the block until its end, on Linux.

    Args:
        most: Bytes beyond what it has then.

    Yields:
        What begins it, when it is called first. Nothing happens where the system has no such
        limit, or a tighter one.
    """
    try:
        resource = importlib.import_module("resource")
        before = resource.getrlimit(resource.RLIMIT_DATA)
    except (ImportError, AttributeError):
        yield lambda: None
        return

    has_started = False

    def begin() -> None:
        nonlocal has_started
        if has_started:
            return
        has_started = True
        used = _used()
        soft, hard = before
        if used is not None and (soft == resource.RLIM_INFINITY or used + most < soft):
            resource.setrlimit(resource.RLIMIT_DATA, (used + most, hard))

    try:
        yield begin
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _used() -> int | None:
    """Bytes of memory that this process can write; None where the system does not say."""
    with contextlib.suppress(OSError, ValueError):
        for line in _STATUS.read_text(encoding="ascii").splitlines():
            if line.startswith("VmData:"):
                return int(line.split()[1]) << 10
    return None
