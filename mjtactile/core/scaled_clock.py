"""The clock of devices, emulator and loop, in seconds that may last longer than the wall's.

`MJTACTILE_SLOW=3` (the command line's `--slow 3`) makes each of them last three: emulated world,
servos' watchdogs, the board's heartbeat, cameras, host and all their time-outs run at a third of
the speed, so that a busy computer keeps up with them. Child processes inherit it. Real devices have
a clock of their own: only emulated ones can be slow.
"""

from __future__ import annotations

import math
import os
import threading
import time

from mjtactile.core.errors import InputError

_NAME = "MJTACTILE_SLOW"


def _from_environment() -> float:
    text = os.environ.get(_NAME, "1")
    try:
        times = float(text)
    except ValueError:
        times = 0.0
    if not 1 <= times < math.inf:
        raise InputError(f"{text!r} is not a number from 1 up", field=_NAME)
    return times


_slow = _from_environment()


def slow() -> float:
    """How many seconds of the wall's one of these lasts."""
    return _slow


def set_slow(times: float) -> None:
    """From now on, in this process and those that it starts. Before any device is connected."""
    global _slow  # noqa: PLW0603  # one pace for all of a process
    _slow = times
    os.environ[_NAME] = repr(times)


def monotonic() -> float:
    """Read the clock of devices, emulator and loop.

    Returns:
        Monotonic time, s; the same in all processes of one pace (`MJTACTILE_SLOW`).
    """
    return time.monotonic() / _slow


def wall(seconds: float) -> float:
    """How long these seconds last on the wall: for a library's time-outs."""
    return seconds * _slow


def sleep(seconds: float) -> None:
    """`time.sleep` at this pace."""
    time.sleep(wall(seconds))


class Event(threading.Event):
    """`threading.Event` that waits at this pace."""

    def wait(self, timeout: float | None = None) -> bool:
        return super().wait(None if timeout is None else wall(timeout))
