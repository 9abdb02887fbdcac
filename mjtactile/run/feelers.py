"""Fingers felt in processes of their own, beside a simulated world that needs the interpreter as much as they do.

A process is given the chains and their states when a run begins, then images, and hands the states back when the run ends: what a
chain finds does not depend on where it runs (docs/decisions/0024-a-process-beside-the-world.md). It is told nothing but images.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import socket
import struct
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from mjtactile.core import pace, process
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image, Touch
from mjtactile.run.perceive import PATIENCE, Outcome, late_touch, outcome_of, value_of
from mjtactile.sensing.chain import Perception

_START = 120.0  # s; a busy computer takes 10 to import what a chain needs
_NUMBER = struct.Struct("<Q")


class Feelers:
    """`count` processes, which start at once; each feels every `count`-th finger. Close them."""

    def __init__(self, count: int) -> None:
        self._feelers = [_Feeler() for _ in range(count)]
        self._perceptions: Sequence[Any] = ()
        self._names: Sequence[str] = ()

    @contextlib.contextmanager
    def at_work(self, perceptions: Sequence[Any], names: Sequence[str]) -> Iterator[Feelers]:
        """Feel with these chains (`Perception`), from the states that they are in; they are left in those that the run ends in.

        Raises DeviceError for a process that does not start.
        """
        self._perceptions, self._names = perceptions, names
        for feeler, own in self._shares(perceptions):
            feeler.begin("take", own)
        for feeler, _ in self._shares(perceptions):
            if feeler.outcome(_START) is None:
                raise DeviceError(f"a process that feels for the loop has not started within {_START:g} s")
        try:
            yield self
        finally:
            self._give_back()

    def perceive(self, images: Sequence[Image], now: float, patience: float = PATIENCE) -> tuple[Touch, ...]:
        """What every sensor feels; see `mjtactile.run.perceive.Perceivers.perceive`.

        Raises DeviceError for a process that has ended, and what a chain raised, when all have answered.
        """
        for feeler, own in self._shares(images):
            feeler.begin("feel", own, now)
        end, felt = pace.monotonic() + patience, list[Outcome | None]([None] * len(images))
        for first, (feeler, own) in enumerate(self._shares(images)):
            answer = feeler.outcome(max(0.0, end - pace.monotonic()))
            felt[first::len(self._feelers)] = [None] * len(own) if answer is None else answer
        return tuple(late_touch(name, image, now) if outcome is None else value_of(outcome)
                     for outcome, name, image in zip(felt, self._names, images, strict=True))

    def _give_back(self) -> None:
        """Those of a process that does not answer any more stay in the states that it began in."""
        with contextlib.suppress(DeviceError):
            for feeler, own in self._shares(self._perceptions):
                feeler.begin("give")
                for perception, state in zip(own, feeler.outcome(PATIENCE) or (), strict=False):
                    perception.state = state

    def close(self) -> None:
        for feeler in self._feelers:
            feeler.close()

    def _shares(self, values: Sequence[Any]) -> list[tuple[_Feeler, list[Any]]]:
        """Each process that has something to do, and what of `values` is its own."""
        shares = [list(values[first::len(self._feelers)]) for first in range(len(self._feelers))]
        return [(feeler, own) for feeler, own in zip(self._feelers, shares, strict=True) if own]


def default_count(cameras: int) -> int:
    """How many processes are worth having beside a simulated world: one a camera, as far as there are processors for them."""
    return min(cameras, len(os.sched_getaffinity(0)) - 1)


class _Feeler:
    """One process: one question and one answer at a time. A question that it has not answered in time is its only one."""

    def __init__(self) -> None:
        ours, its = socket.socketpair()
        self._process = process.start(__name__, its.fileno(), descriptors=(its.fileno(),))
        its.close()
        self._wire, self._due, self._is_late = _Wire(ours), 0, False

    def begin(self, *question: Any) -> None:
        """Raises DeviceError when it has ended, or takes nothing."""
        try:
            while self._due and self._wire.receive(0.0) is not None:
                self._due -= 1  # nobody waits for it any more
            self._is_late = self._due > 0
            if not self._is_late:
                self._wire.send(*question)
                self._due += 1
        except OSError as error:
            raise self._ended() from error

    def outcome(self, patience: float) -> tuple[Any, ...] | None:
        """The answer; None if there was none within `patience` s."""
        if self._is_late:
            return None
        try:
            answer = self._wire.receive(patience)
        except OSError as error:
            raise self._ended() from error
        self._due -= answer is not None
        return answer

    def close(self) -> None:
        self._wire.close()
        process.stop(self._process)

    def _ended(self) -> DeviceError:
        return DeviceError(f"a process that feels for the loop has ended ({process.how_it_ended(self._process)})")


class _Wire:
    """Values over a socket. Arrays are not pickled but follow as they are, and arrive read-only."""

    def __init__(self, end: socket.socket) -> None:
        self._end, self._filled = end, 0
        self._room = bytearray(_NUMBER.size)  # for the size of a message, then for all the rest of it
        self._sized = False

    def send(self, *value: Any) -> None:
        """Raises OSError, also when the other end takes nothing for `PATIENCE` s."""
        arrays: list[pickle.PickleBuffer] = []
        parts: list[Any] = [pickle.dumps(value, protocol=5, buffer_callback=arrays.append)]
        parts += [array.raw() for array in arrays]
        sizes = [memoryview(part).nbytes for part in parts]
        head = struct.pack(f"<{1 + len(sizes)}Q", len(sizes), *sizes)
        self._end.settimeout(pace.wall(PATIENCE))
        for part in (_NUMBER.pack(len(head) + sum(sizes)), head, *parts):
            self._end.sendall(part)

    def receive(self, patience: float | None) -> tuple[Any, ...] | None:
        """What was sent; None if it is not all there within `patience` s (None: wait), and then it is received on the next time.
        Raises OSError when there is no other end any more."""
        end = math.inf if patience is None else pace.monotonic() + patience
        while self._filled < len(self._room) or not self._sized:
            if self._filled == len(self._room):
                self._room, self._filled, self._sized = bytearray(_NUMBER.unpack(self._room)[0]), 0, True
                continue
            self._end.settimeout(None if math.isinf(end) else pace.wall(max(end - pace.monotonic(), 1e-6)))
            try:
                more = self._end.recv_into(memoryview(self._room)[self._filled:])
            except TimeoutError:
                return None
            if not more:
                raise ConnectionError
            self._filled += more
        whole = memoryview(self._room).toreadonly()
        self._room, self._filled, self._sized = bytearray(_NUMBER.size), 0, False
        return _value(whole)

    def close(self) -> None:
        self._end.close()


def _value(whole: memoryview) -> tuple[Any, ...]:
    """What a message holds; its arrays stay where they are."""
    count, parts = _NUMBER.unpack_from(whole)[0], []
    start = _NUMBER.size * (1 + count)
    for (size,) in _NUMBER.iter_unpack(whole[_NUMBER.size:start]):
        parts.append(whole[start:start + size])
        start += size
    return pickle.loads(parts[0], buffers=parts[1:])


def serve(wire: _Wire) -> None:
    """What a process does until its parent hangs up: takes chains, feels images, and gives the chains' states back."""
    perceptions: list[Perception] = []
    with contextlib.suppress(OSError):
        while True:
            match wire.receive(None):
                case "take", own:
                    perceptions = own
                    wire.send()
                case "feel", images, now:
                    wire.send(*[outcome_of(perception.perceive, image, now)
                                for perception, image in zip(perceptions, images, strict=True)])
                case ("give",):
                    wire.send(*[perception.state for perception in perceptions])


if __name__ == "__main__":
    import cv2

    cv2.setNumThreads(1)  # the other processors are the world's
    serve(_Wire(socket.socket(fileno=int(sys.argv[1]))))
