"""Pseudo-terminal that acts as a serial port, served by a thread."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import tty
from collections.abc import Callable

from mjtactile.core import scaled_clock

_OPEN_POLL = 0.005  # period of the check for an opened port, s


class PtyPort:
    """Pseudo-terminal that serves one host.

    A thread calls `handle(data)` with the bytes from the host; `write` sends a reply. `path` is the
    device path for the host.

    `on_open` is called each time a host opens the port (for a board that resets then). Bytes that
    the host never reads are lost once the port's buffer is full, as on a wire.
    """

    def __init__(
        self,
        handle: Callable[[bytes], None],
        name: str,
        *,
        on_open: Callable[[], None] | None = None,
    ):
        self._master, slave = os.openpty()
        os.set_blocking(self._master, False)
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        self._handle = handle
        self._on_open = on_open
        self._wake_read, self._wake_write = os.pipe()
        self._lock = threading.Lock()
        self._is_open = True
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    @property
    def baud(self) -> int:
        """The speed that the host has set on its side, as a termios constant."""
        return termios.tcgetattr(self._master)[5]

    @property
    def has_input(self) -> bool:
        """Bytes wait to be read. (`select` would also call a port readable that the host has
        closed.)"""
        poll = select.poll()
        with self._lock:
            if not self._is_open:
                return False
            poll.register(self._master, select.POLLIN)
            return any(
                event & select.POLLIN and not event & select.POLLHUP for _, event in poll.poll(0)
            )

    def write(self, data: bytes) -> None:
        """Send to the host; without effect if the port is closed."""
        with self._lock, contextlib.suppress(OSError):
            if self._is_open:
                os.write(self._master, data)

    def close(self) -> None:
        """Disconnect the host: its next read or write fails as after unplugging a USB adapter."""
        with self._lock:
            if not self._is_open:
                return
            self._is_open = False
            os.write(self._wake_write, b"x")
        if threading.current_thread() is not self._thread:
            self._thread.join()
        for descriptor in (self._master, self._wake_read, self._wake_write):
            os.close(descriptor)

    def _serve(self) -> None:
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        poll.register(self._wake_read, select.POLLIN)
        host_is_connected = False
        while True:
            events = dict(poll.poll())
            if self._wake_read in events:
                return
            event = events.get(self._master, 0)
            if event & select.POLLHUP and not event & select.POLLIN:
                host_is_connected = False
                scaled_clock.sleep(_OPEN_POLL)
                if not self._host_opened(poll):
                    continue
            if not host_is_connected:
                host_is_connected = True
                if self._on_open is not None:
                    self._on_open()
            with contextlib.suppress(OSError):  # the host closed its side
                data = os.read(self._master, 4096) if event & select.POLLIN else b""
                if data:
                    self._handle(data)

    def _host_opened(self, poll: select.poll) -> bool:
        return not any(fd == self._master and event & select.POLLHUP for fd, event in poll.poll(0))
