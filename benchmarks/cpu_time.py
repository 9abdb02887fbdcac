"""Core time of a run that has processes beside it."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path


def core_time() -> float:
    """s that this process and those that it has started, and that still run, have computed."""
    tick = os.sysconf("SC_CLK_TCK")
    total = time.process_time()
    for children in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):  # a thread or a process that has just ended
            for pid in children.read_text().split():
                fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
                total += (int(fields[11]) + int(fields[12])) / tick
    return total
