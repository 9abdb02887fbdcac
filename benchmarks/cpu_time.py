"""Core time of a run with child processes."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path


def core_time() -> float:
    """Return the core time, s, of this process and its children that still run."""
    tick = os.sysconf("SC_CLK_TCK")
    total = time.process_time()
    for children in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):  # a thread or a process that has just ended
            for pid in children.read_text().split():
                fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
                total += (int(fields[11]) + int(fields[12])) / tick
    return total
