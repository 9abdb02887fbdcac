"""A process of this package's own beside a run: it is asked one thing at a time, by values over a
socket, and nobody waits for it longer than he wants to."""

from __future__ import annotations

import contextlib
import math
import pickle
import socket
import struct
from typing import Any

from mjtactile.core import pace, process
from mjtactile.core.errors import DeviceError

_TAKES = 10.0  # s in which a process takes a question
_NUMBER = struct.Struct("<Q")


class WorkerProcess:
    """A process that runs `module`, which answers on `Channel.of(sys.argv[1])`; `does` says what
    for, in an error. It starts at once, and is given no other question before it has answered the
    last one. Close it.

    Raises OSError where there is no room for another process.
    """

    def __init__(self, module: str, does: str) -> None:
        ours, its = socket.socketpair()
        self._channel = Channel(ours, _TAKES)
        self._does = does
        self._due = 0
        self._is_late = False
        with its, contextlib.ExitStack() as unless_it_starts:
            unless_it_starts.callback(ours.close)
            self._process = process.start(module, its.fileno(), descriptors=(its.fileno(),))
            unless_it_starts.pop_all()

    def begin(self, *question: Any) -> None:
        """Raises DeviceError when it has ended, or takes nothing."""
        try:
            while self._due and self._channel.receive(0.0) is not None:
                self._due -= 1  # nobody waits for it any more
            self._is_late = self._due > 0
            if not self._is_late:
                self._channel.send(*question)
                self._due += 1
        except OSError as error:
            self._channel.close()  # who has taken half of a question can be asked no other
            raise self._ended() from error

    def outcome(self, patience: float) -> tuple[Any, ...] | None:
        """The answer; None if there was none within `patience` s."""
        if self._is_late:
            return None
        try:
            answer = self._channel.receive(patience)
        except OSError as error:
            raise self._ended() from error
        self._due -= answer is not None
        return answer

    def close(self) -> None:
        self._channel.close()
        process.stop(self._process)

    def _ended(self) -> DeviceError:
        return DeviceError(
            f"a process that {self._does} has ended ({process.how_it_ended(self._process)})"
        )


class Channel:
    """Values over a socket. Arrays are not pickled but follow as they are, and arrive read-only.
    The other end takes what it is sent within `takes` s (None: when it likes)."""

    def __init__(self, end: socket.socket, takes: float | None = None) -> None:
        self._end = end
        self._takes = takes
        self._filled = 0
        # for the size of a message, then for all the rest of it
        self._room = bytearray(_NUMBER.size)
        self._sized = False

    @classmethod
    def of(cls, descriptor: str) -> Channel:
        """The end that a process was started with."""
        return cls(socket.socket(fileno=int(descriptor)))

    def send(self, *value: Any) -> None:
        """Raises OSError, also when the other end does not take it."""
        arrays: list[pickle.PickleBuffer] = []
        parts: list[Any] = [pickle.dumps(value, protocol=5, buffer_callback=arrays.append)]
        parts += [array.raw() for array in arrays]
        sizes = [memoryview(part).nbytes for part in parts]
        head = struct.pack(f"<{1 + len(sizes)}Q", len(sizes), *sizes)
        self._end.settimeout(None if self._takes is None else pace.wall(self._takes))
        self._end.sendall(b"".join([_NUMBER.pack(len(head) + sum(sizes)), head, *parts]))

    def receive(self, patience: float | None) -> tuple[Any, ...] | None:
        """What was sent; None if it is not all there within `patience` s (None: wait), and then it
        is received on the next time. Raises OSError when there is no other end any more."""
        end = math.inf if patience is None else pace.monotonic() + patience
        while self._filled < len(self._room) or not self._sized:
            if self._filled == len(self._room):
                self._room = bytearray(_NUMBER.unpack(self._room)[0])
                self._filled = 0
                self._sized = True
                continue
            self._end.settimeout(
                None if math.isinf(end) else pace.wall(max(end - pace.monotonic(), 1e-6))
            )
            try:
                more = self._end.recv_into(memoryview(self._room)[self._filled :])
            except TimeoutError:
                return None
            if not more:
                raise ConnectionError
            self._filled += more
        whole = memoryview(self._room).toreadonly()
        self._room = bytearray(_NUMBER.size)
        self._filled = 0
        self._sized = False
        return _value(whole)

    def close(self) -> None:
        self._end.close()


def _value(whole: memoryview) -> tuple[Any, ...]:
    """What a message holds; its arrays stay where they are."""
    count = _NUMBER.unpack_from(whole)[0]
    parts = []
    start = _NUMBER.size * (1 + count)
    for (size,) in _NUMBER.iter_unpack(whole[_NUMBER.size : start]):
        parts.append(whole[start : start + size])
        start += size
    return pickle.loads(parts[0], buffers=parts[1:])
