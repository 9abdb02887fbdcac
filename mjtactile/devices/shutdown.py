"""Ending safely: every device gets its turn, and no signal cuts it short."""

from __future__ import annotations

import contextlib
import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator

from mjtactile.errors import DeviceError

_log = logging.getLogger(__name__)


@contextlib.contextmanager
def signals_later() -> Iterator[None]:
    """Keep Ctrl-C and SIGTERM from cutting a shutdown short; they arrive when it is done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def close_all(closers: list[Callable[[], None]]) -> None:
    """Call every closer, last one first, whatever the others do; then raise DeviceError with all that failed.

    When another exception is on its way out already, the failures are only logged.
    """
    failures = []
    on_its_way = sys.exc_info()[0] is not None
    with signals_later():
        while closers:
            try:
                closers.pop()()
            except Exception as error:  # noqa: BLE001  # every device must get its turn
                failures.append(str(error))
                _log.error("%s", error)
    if failures and not on_its_way:
        raise DeviceError("; ".join(failures))
