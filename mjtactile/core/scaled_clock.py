"""Clock of devices, emulator and loop; its seconds may exceed wall-clock seconds.

`MJTACTILE_TIME_SCALE=3` makes each second last three wall-clock seconds. The command line's
`--time-scale 3` does the same. Emulated world, servo watchdogs, board heartbeat and cameras then
run at a third of the speed. The same applies to the host and all timeouts. A busy computer can
therefore keep up. Child processes inherit the setting. Real devices have their own clock: only
emulated ones can be slowed down.
"""

from __future__ import annotations

import math
import os
import threading
import time

from mjtactile.core.errors import InputError

_NAME = "MJTACTILE_TIME_SCALE"


def _from_environment() -> float:
    text = os.environ.get(_NAME, "1")
    try:
        times = float(text)
    except ValueError:
        times = 0.0
    if not 1 <= times < math.inf:
        raise InputError(f"{text!r} is not a number of at least 1", field=_NAME)
    return times


_slow = _from_environment()


def slow() -> float:
    """Return the duration of one scaled second in wall-clock seconds."""
    return _slow


def set_slow(times: float) -> None:
    """Set the wall-clock seconds per scaled second, for this process and those it starts later.
    Call it before any device is connected."""
    global _slow  # noqa: PLW0603  # one pace for all of a process
    _slow = times
    os.environ[_NAME] = repr(times)


def monotonic() -> float:
    """Read the clock of devices, emulator and loop.

    Returns:
        Monotonic time, s; the same in all processes of one pace (`MJTACTILE_TIME_SCALE`).
    """
    return time.monotonic() / _slow


def wall(seconds: float) -> float:
    """Convert scaled seconds to wall-clock seconds, for timeouts of libraries."""
    return seconds * _slow


def sleep(seconds: float) -> None:
    """Wait for `seconds` of this clock."""
    time.sleep(wall(seconds))


class Event(threading.Event):
    """`threading.Event` that waits at this pace."""

    def wait(self, timeout: float | None = None) -> bool:
        return super().wait(None if timeout is None else wall(timeout))
