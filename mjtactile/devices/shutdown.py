"""Ending safely: every device gets its turn, and no signal cuts it short."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable

from mjtactile.core.errors import DeviceError
from mjtactile.core.signals import deferred

_log = logging.getLogger(__name__)


def close_all(closers: list[Callable[[], None]]) -> None:
    """Call every closer, last one first, even after failures. Then raise DeviceError with all
    failures.

    If another exception is already being raised, the failures are only logged.
    """
    failures = []
    in_transit = sys.exc_info()[0] is not None
    with deferred():
        while closers:
            try:
                closers.pop()()
            except Exception as error:  # noqa: BLE001  # every device must get its turn
                failures.append(str(error))
                _log.error("%s", error)
    if failures and not in_transit:
        raise DeviceError("; ".join(failures))
