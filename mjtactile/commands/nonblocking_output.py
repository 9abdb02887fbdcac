"""Output that never blocks the program.

A terminal may be stopped (Ctrl-S), a reader may have left, or a disk may be full.
"""

from __future__ import annotations

import collections
import contextlib
import os
import select
import threading
from types import TracebackType

_WAITING_MAX = 1 << 20  # bytes buffered for a blocked output; further output is dropped
_FLUSH_TIME = 0.5  # maximum wait for a blocked output on exit, s
_POLL_MS = 100


class Background:
    """Pipe whose content is written to file descriptor `target`. Enter it to get the descriptor to
    write to.

    One thread empties the pipe, so that writing to it neither blocks nor fails. A second thread
    writes to the target. The last writer must flush its own buffer before the exit. A closed target
    is replaced by /dev/null, so that later output does not fail either.
    """

    def __init__(self, target: int):
        self._number = target
        self._target = os.dup(target)
        self._out, self._in = os.pipe()
        self._waiting: collections.deque[bytes] = collections.deque()
        self._change = threading.Condition()
        self._ending = self._ended = self._broken = False
        self._threads = [
            threading.Thread(target=work, name="output", daemon=True)
            for work in (self._empty, self._write)
        ]

    def __enter__(self) -> int:
        for thread in self._threads:
            thread.start()
        return self._in

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._in)
        self._ending = True
        for thread in self._threads:
            thread.join(_FLUSH_TIME)
        if self._broken:
            with contextlib.suppress(OSError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, self._number)
                os.close(null)

    def _empty(self) -> None:
        """Read from the pipe until the end of output. A child process may keep the pipe open
        longer."""
        poll = select.poll()
        poll.register(self._out, select.POLLIN)
        while True:
            if not poll.poll(_POLL_MS):
                if self._ending:
                    break
                continue
            data = os.read(self._out, 1 << 16)
            if not data:
                break
            with self._change:
                if sum(map(len, self._waiting)) < _WAITING_MAX:
                    self._waiting.append(data)
                self._change.notify()
        os.close(self._out)
        with self._change:
            self._ended = True
            self._change.notify()

    def _write(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._waiting or self._ended)
                if not self._waiting:
                    break
                data = self._waiting.popleft()
            while data and not self._broken:
                try:
                    data = data[os.write(self._target, data) :]
                except OSError:  # the target is closed
                    self._broken = True
        os.close(self._target)
