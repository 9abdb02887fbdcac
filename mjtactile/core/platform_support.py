"""What operating systems do differently, each thing in one function: Linux's way where there is
one, else one that works on every POSIX system."""

from __future__ import annotations

import os
import sys

REFUSAL = "mjtactile runs on Linux and macOS; on Windows, inside WSL (Windows Subsystem for Linux)"


def is_supported() -> bool:
    """False on Windows, which has neither serial ports nor signals nor pseudo-terminals of POSIX's
    kind."""
    return sys.platform != "win32"


def processors() -> int:
    """How many processors this process may use; all that there are where that is not told."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def memory_file(name: str) -> int:
    """A file descriptor of an empty file without a path, for memory that processes share: in memory
    where that can be had, else on the disk. `name` is for whoever looks at this process from
    outside."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create(name)
    import tempfile  # lazily: it imports much that Linux does not need

    with tempfile.TemporaryFile(prefix=name) as file:
        return os.dup(file.fileno())


def watch_process(pid: int) -> int | None:
    """A file descriptor that can be read when the process `pid` has ended; None where it cannot be
    had (no such process any more, a sandbox that forbids it, a system without such a thing)."""
    if not hasattr(os, "pidfd_open"):
        return None
    try:
        return os.pidfd_open(pid)
    except OSError:
        return None
