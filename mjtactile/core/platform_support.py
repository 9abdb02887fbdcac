"""Platform differences, each in one function: the Linux call where available, else one that works
on every POSIX system."""

from __future__ import annotations

import os
import sys

REFUSAL = "mjtactile runs on Linux and macOS; on Windows, inside WSL (Windows Subsystem for Linux)"


def is_supported() -> bool:
    """Return False on Windows, which has no POSIX serial ports, signals and pseudo-terminals."""
    return sys.platform != "win32"


def processors() -> int:
    """Return the number of processors available to this process; all processors if this is unknown.

    The environment variable PYTHON_CPU_COUNT replaces it, as in Python 3.13.
    """
    given = os.environ.get("PYTHON_CPU_COUNT", "")
    if given.isdecimal() and int(given) > 0:
        return int(given)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def memory_file(name: str) -> int:
    """Return a file descriptor of an empty file without a path, for memory shared by processes.

    The file is in memory if supported, otherwise on the disk. `name` identifies it in process
    inspection tools.
    """
    if hasattr(os, "memfd_create"):
        return os.memfd_create(name)
    import tempfile  # lazily: it imports much that Linux does not need

    with tempfile.TemporaryFile(prefix=name) as file:
        return os.dup(file.fileno())


def watch_process(pid: int) -> int | None:
    """Return a file descriptor that becomes readable when the process `pid` has ended.

    None if this is not available (the process has ended, a sandbox forbids it, or the system lacks
    it).
    """
    if not hasattr(os, "pidfd_open"):
        return None
    try:
        return os.pidfd_open(pid)
    except OSError:
        return None
