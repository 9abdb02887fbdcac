"""Writing to a serial port from a process that may be suspended."""

from __future__ import annotations

import contextlib
import select
from typing import Any

import serial


def write(port: Any, data: bytes) -> int:
    """Write `data` to a pySerial port; return the number of bytes written.

    pySerial's timeout includes time in which this process was stopped, even after a complete write.
    A port that accepts more data is not blocked; lost data is detected by the missing answer.
    Raises SerialException.
    """
    try:
        return port.write(data) or 0
    except serial.SerialTimeoutException:
        if not _takes_more(port):
            raise
        return len(data)


def _takes_more(port: Any) -> bool:
    with contextlib.suppress(AttributeError, OSError, ValueError):  # a port without a descriptor
        return bool(select.select([], [port.fileno()], [], 0)[1])
    return False
