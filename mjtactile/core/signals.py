"""Signals that end a process. While devices are connected, signals are stored and handled where the
loop allows it.

Python's own reaction to Ctrl-C is an exception at an arbitrary point of the main thread. It could
abort a shutdown: torque on, chambers sealed. Blocking a signal in one thread does not help, since
any other thread receives it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

from mjtactile.core.errors import Interrupted


def _existing_signals(*names: str) -> tuple[signal.Signals, ...]:
    """Return the signals that exist on this system; no system has all."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


URGENT = _existing_signals("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
"""Signals that a user may send again to skip the orderly end."""
OTHERS = (
    *_existing_signals("SIGABRT", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGUSR1", "SIGUSR2"),
    *_existing_signals("SIGXCPU", "SIGPOLL", "SIGPWR", "SIGSTKFLT"),
    *range(getattr(signal, "SIGRTMIN", 0), getattr(signal, "SIGRTMAX", -1) + 1),
)
"""Further signals that end a process which does not handle them.

Examples are a batch queue's warning, a timer, and used-up processor time. The last one repeats
every second.
"""
ENDING = URGENT + OTHERS
# debounce time, s: a repeated signal sooner after the first one is ignored (key bounce, a shell
# that repeats it)
SECOND_TIME = 1.0
LEAVE_TIME = 1.0  # time for the process to exit after all devices are disconnected, s
EXIT_CODE = Interrupted.exit_code


class Stop:
    """Requests received by signals: `asked` to end in order, `at_once` (a second signal) to end
    without delay."""

    def __init__(self, *, ends_process: bool = False):
        self.asked = self.at_once = False
        self._urgent_since: float | None = None
        self._deferrals = 0
        self._ends_process = ends_process

    def check(self) -> None:
        """Raise Interrupted after a signal."""
        if self.asked:
            raise Interrupted

    def hear(self, signal_number: int, frame: FrameType | None) -> None:
        """Handle a signal: store it, and raise KeyboardInterrupt only while no device is
        connected."""
        now = time.monotonic()
        is_first = not self.asked
        self.asked = True
        if signal_number in URGENT:
            if self._urgent_since is None:
                self._urgent_since = now
            elif now - self._urgent_since >= SECOND_TIME:
                self.at_once = True
        if not self._deferrals and (is_first or self.at_once):
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def defer(self) -> Iterator[None]:
        """Defer signals within this block. Raise Interrupted at its end if a signal arrived
        meanwhile."""
        before = self.asked
        self._deferrals += 1
        try:
            yield
        finally:
            self._deferrals -= 1
            if not self._deferrals and self.asked and self._ends_process:
                _leave_within(LEAVE_TIME)
        if not self._deferrals and self.asked and not before:
            raise Interrupted


_heard: Stop | None = None  # signals belong to the process, and so does this


@contextlib.contextmanager
def listening(*, ends_process: bool = False) -> Iterator[Stop]:
    """Handle the signals in `ENDING`. Signals ignored by the process (nohup) stay ignored, and
    those of `OTHERS` with their own handler keep it.

    A nested block yields the `Stop` of the outer one. Outside of the main thread no signal is
    handled, since Python installs no handlers there. `ends_process`: the process ends with this
    block, and the signals are ignored afterwards. After a deferral with a signal, the process exits
    within LEAVE_TIME, even if a call hangs.
    """
    global _heard  # noqa: PLW0603
    if _heard is not None or threading.current_thread() is not threading.main_thread():
        yield _heard or Stop()
        return
    _heard = stop = Stop(ends_process=ends_process)
    handlers = {signal_number: signal.getsignal(signal_number) for signal_number in ENDING}
    before = {
        signal_number: handler
        for signal_number, handler in handlers.items()
        if handler is signal.SIG_DFL
        or (
            signal_number in URGENT and handler not in (signal.SIG_IGN, None)
        )  # None: not installed by Python
    }
    try:
        for signal_number in before:
            signal.signal(signal_number, stop.hear)
        yield stop
    finally:
        for signal_number, handler in before.items():
            signal.signal(signal_number, signal.SIG_IGN if ends_process else handler)
        _heard = None


@contextlib.contextmanager
def deferred() -> Iterator[Stop]:
    """Defer signals within this block, while devices are connected. See `Stop.defer`."""
    with listening() as stop, stop.defer():
        yield stop


def check() -> None:
    """Raise Interrupted if a signal was deferred. Call this only at a point where stopping is
    safe."""
    if _heard is not None:
        _heard.check()


def _leave_within(seconds: float) -> None:
    """End the process after `seconds` s if it is still there: an output that blocks must not keep
    it."""
    timer = threading.Timer(seconds, os._exit, (EXIT_CODE,))
    timer.daemon = True
    timer.start()
