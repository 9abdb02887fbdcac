"""Worker process of this package: answers one question at a time over a socket, with timeouts."""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import pickle
import socket
import struct
from collections.abc import Sequence
from typing import Any

from mjtactile.core import platform_support, process, scaled_clock
from mjtactile.core.errors import DeviceError

_TAKES = 10.0  # time limit for a process to accept a question, s
_NUMBER = struct.Struct("<Q")
# Memory shared between a process and its parent, bytes: two images of 1280 x 960 pixels and more. A
# socket holds a fifth of a megabyte, so both ends would have to alternate.
_ROOM = 1 << 22
_EVEN = 64  # alignment of arrays in the shared memory, bytes


class WorkerProcess:
    """Process that runs `module`, which answers on `Channel.of(sys.argv[1])`.

    `does` describes its purpose in error messages. It starts immediately. It gets the next question
    only after it has answered the previous one. The caller must close it.

    Raises OSError if another process cannot be started.
    """

    def __init__(self, module: str, does: str) -> None:
        own_end, child_end = socket.socketpair()
        self._does = does
        self._due = 0
        self._is_late = False
        with child_end, contextlib.ExitStack() as close_on_failure:
            close_on_failure.callback(own_end.close)
            file = platform_support.memory_file("mjtactile")
            os.ftruncate(file, _ROOM)
            try:
                self._channel = Channel(own_end, _TAKES, lent=mmap.mmap(file, _ROOM))
                self._process = process.start(
                    module, f"{child_end.fileno()},{file}", descriptors=(child_end.fileno(), file)
                )
            finally:
                os.close(file)
            close_on_failure.pop_all()

    def start(self, *question: Any) -> None:
        """Send a question to the worker process.

        A late answer to an earlier question is discarded first. Raises DeviceError if the process
        has ended or accepts no message.
        """
        try:
            while self._due and self._channel.receive(0.0) is not None:
                self._due -= 1  # a late answer is discarded
            self._is_late = self._due > 0
            if not self._is_late:
                self._channel.send(*question)
                self._due += 1
        except OSError as error:
            # a process that received half of a request cannot receive another
            self._channel.close()
            raise self._ended() from error

    def outcome(self, timeout: float) -> tuple[Any, ...] | None:
        """Return the answer; None if there is none within `timeout`, s."""
        if self._is_late:
            return None
        try:
            answer = self._channel.receive(timeout)
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
    """Transfer of Python values over a socket.

    Arrays are not pickled. They are sent as raw bytes or, if they fit, through shared memory `lent`
    to the other end. They arrive read-only. The other end must accept a message within `takes` s
    (None: no limit). The lending end must not send another message before it has received an
    answer.
    """

    def __init__(
        self,
        end: socket.socket,
        takes: float | None = None,
        *,
        lent: mmap.mmap | None = None,
        given: mmap.mmap | None = None,
    ) -> None:
        self._end = end
        self._takes = takes
        self._lent = lent
        self._given = given
        self._filled = 0
        # for the size of a message, then for all the rest of it
        self._room = bytearray(_NUMBER.size)
        self._sized = False

    @classmethod
    def of(cls, descriptors: str) -> Channel:
        """Open the channel end whose descriptors this process received at its start."""
        end, file = map(int, descriptors.split(","))
        given = mmap.mmap(file, _ROOM, access=mmap.ACCESS_READ)
        os.close(file)
        return cls(socket.socket(fileno=end), given=given)

    def send(self, *value: Any) -> None:
        """Send values. Raises OSError, also if the other end does not receive them in time."""
        buffers: list[pickle.PickleBuffer] = []
        pickled = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
        arrays = [buffer.raw() for buffer in buffers]
        sizes = [len(pickled), *(array.nbytes for array in arrays)]
        is_lent = self._lend(arrays)
        head = struct.pack(f"<{2 + len(sizes)}Q", is_lent, len(sizes), *sizes)
        parts = [head, pickled, *([] if is_lent else arrays)]
        length = sum(memoryview(part).nbytes for part in parts)
        self._end.settimeout(None if self._takes is None else scaled_clock.wall(self._takes))
        self._end.sendall(b"".join([_NUMBER.pack(length), *parts]))

    def _lend(self, arrays: Sequence[memoryview]) -> bool:
        """Copy the arrays to the shared memory. Return False without one, or if they do not fit."""
        if self._lent is None or sum(map(_even, (a.nbytes for a in arrays))) > len(self._lent):
            return False
        start = 0
        for array in arrays:
            self._lent[start : start + array.nbytes] = array
            start += _even(array.nbytes)
        return True

    def receive(self, timeout: float | None) -> tuple[Any, ...] | None:
        """Return the received values.

        Return None if the message is incomplete after `timeout` s (None: no limit). The next
        call then continues to receive it. Raises OSError if the other end has closed.
        """
        end = math.inf if timeout is None else scaled_clock.monotonic() + timeout
        while self._filled < len(self._room) or not self._sized:
            if self._filled == len(self._room):
                self._room = bytearray(_NUMBER.unpack(self._room)[0])
                self._filled = 0
                self._sized = True
                continue
            self._end.settimeout(
                None
                if math.isinf(end)
                else scaled_clock.wall(max(end - scaled_clock.monotonic(), 1e-6))
            )
            try:
                more = self._end.recv_into(memoryview(self._room)[self._filled :])
            except TimeoutError:
                return None
            if not more:
                raise ConnectionError
            self._filled += more
        room = memoryview(self._room).toreadonly()
        self._room = bytearray(_NUMBER.size)
        self._filled = 0
        self._sized = False
        return _value(room, self._given)

    def close(self) -> None:
        self._end.close()
        if self._lent is not None:
            self._lent.close()
            self._lent = None  # a later question then fails at the socket


def _value(room: memoryview, given: mmap.mmap | None) -> tuple[Any, ...]:
    """Return the content of a message. Arrays in the sender's memory are copied; others are not."""
    is_lent, count = struct.unpack_from("<2Q", room)
    start = _NUMBER.size * (2 + count)
    sizes = struct.unpack_from(f"<{count}Q", room, 2 * _NUMBER.size)
    pickled = room[start : start + sizes[0]]
    start += sizes[0]
    source: memoryview | mmap.mmap = room
    if is_lent:
        assert given is not None
        source, start = given, 0
    arrays = []
    for size in sizes[1:]:
        arrays.append(source[start : start + size])
        start += _even(size) if is_lent else size
    return pickle.loads(pickled, buffers=arrays)


def _even(size: int) -> int:
    return -(-size // _EVEN) * _EVEN
