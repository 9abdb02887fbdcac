"""Sensing chains in processes of their own, so that two fingers are felt at the same time and beside a simulated world.

Python computes in one thread of a process at a time. `Workers` starts processes that import what the chain needs while the
rig is being built; a `RemotePerception` then stands in for the `Perception` of one sensor, and `perceive` hands every image
out before it waits for an answer. An image goes through shared memory, everything else through a socket. A worker runs the
same code on the same numbers, so that a run gives the same bits with and without it (docs/decisions/0006-a-process-a-sensor.md).
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import pickle
import socket
import struct
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any, Protocol, cast

import numpy as np

from mjtactile.core import process, signals
from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Image, Touch
from mjtactile.sensing.settings import DEFAULTS, Settings

START_TIME = 60  # s for a worker to import everything, on a busy computer
REPLY_TIME = 10  # s for an answer; a chain needs a hundredth of a second for an image


class Perceiver(Protocol):
    """One sensor's perception, wherever it runs; see `mjtactile.sensing.chain.Perception`."""

    def take_flat(self, images: Sequence[Image]) -> Any: ...
    def take_rest(self, images: Sequence[Image], pressure_gauge: float, *, sealed: bool = True) -> Any: ...
    def perceive(self, image: Image, now: float) -> Touch: ...


def perceive(perceivers: Sequence[Perceiver], images: Sequence[Image], now: float, patience: float = REPLY_TIME
             ) -> tuple[Touch, ...]:
    """What every sensor feels: all images are handed out first, then this process does its own share, then it collects.

    A process that does not answer within `patience` s makes its touch unknown, and is not waited for again before it has.
    """
    pairs = list(zip(perceivers, images, strict=True))
    for chain, image in pairs:
        if isinstance(chain, RemotePerception):
            chain.hand_out(image, now)
    own = [None if isinstance(chain, RemotePerception) else chain.perceive(image, now) for chain, image in pairs]
    end = time.monotonic() + patience
    return tuple(chain.collect(image, now, max(0.0, end - time.monotonic())) if isinstance(chain, RemotePerception)
                 else cast(Touch, touch) for (chain, image), touch in zip(pairs, own, strict=True))


def unknown_touch(image: Image, now: float, status: Status) -> Touch:
    """Nothing is known of the touch in `image`; `status` says why."""
    return Touch(image.time, now - image.time, math.nan, math.nan, False, status=status)


def default_workers(cameras: int = 2) -> int:
    """How many processes are worth their start: one a camera, none where there is one processor or one camera."""
    return cameras if cameras > 1 and len(os.sched_getaffinity(0)) > 1 else 0


class Workers:
    """`count` processes for sensing chains, importing from the start on. Use as a context manager: none outlives it."""

    def __init__(self, count: int):
        self._workers = [_Worker() for _ in range(count)]

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def perceptions(self, designs: Mapping[str, SensorDesign],
                    calibrations: Mapping[str, Calibration | None] = MappingProxyType({}),
                    settings: Settings = DEFAULTS) -> list[Perceiver]:
        """One for each sensor, by its name, with what was measured of it; the last ones in the workers, the others here."""
        from mjtactile.sensing.chain import Perception

        names = list(designs)
        own = max(len(names) - len(self._workers), 0)
        return [*(Perception.of(designs[name], calibrations.get(name), settings=settings) for name in names[:own]),
                *(RemotePerception(worker, name, designs[name], calibrations.get(name), settings)
                  for worker, name in zip(self._workers, names[own:], strict=False))]

    @property
    def pids(self) -> list[int]:
        return [worker.pid for worker in self._workers]

    def close(self) -> None:
        """End the processes; they keep nothing that would be lost."""
        for worker in self._workers:
            worker.close()


class RemotePerception:
    """Stands in for the `Perception` of the sensor `name` ("left", "right") in a worker.

    Errors of the chain are raised here as they were raised there; one that ends is a DeviceError. One that does not answer
    is a DeviceError while references are taken, and later says nothing of the touch.
    """

    def __init__(self, worker: _Worker, name: str, design: SensorDesign, calibration: Calibration | None, settings: Settings):
        self.design, self.name, self._worker = design, name, worker
        self._due, self._is_ready = 0, False  # answers that are due; whether it has ever answered
        self._is_late, self._patience = False, float(REPLY_TIME)
        shape = design.camera.height, design.camera.width
        worker.memory.truncate(shape[0] * shape[1])
        self._pixels = np.frombuffer(mmap.mmap(worker.memory.fileno(), 0), np.uint8).reshape(shape)
        self._send("open", design, calibration, settings=settings)

    @property
    def pid(self) -> int:
        return self._worker.pid

    def take_flat(self, images: Sequence[Image]) -> Any:
        return self._call("take_flat", list(images))

    def take_rest(self, images: Sequence[Image], pressure_gauge: float, *, sealed: bool = True) -> Any:
        return self._call("take_rest", list(images), pressure_gauge, sealed=sealed)

    def perceive(self, image: Image, now: float) -> Touch:
        self.hand_out(image, now)
        return self.collect(image, now, REPLY_TIME)

    def hand_out(self, image: Image, now: float) -> None:
        """Let the worker begin with an image, unless it still works on an older one; then `collect` its touch."""
        if not self._is_ready:
            self._settle()
        while self._due and self._wait(0.0 if self._is_late else self._patience):
            self._receive()  # of an older image: it came too late, or another sensor failed then
        self._is_late = self._due > 0
        if self._is_late:  # the shared memory is not free
            return
        if image.pixels.shape == self._pixels.shape:
            self._pixels[:] = image.pixels
            self._send("perceive_shared", image.time, now)
        else:  # the chain says what is wrong with it
            self._send("perceive", image, now)

    def collect(self, image: Image, now: float, patience: float) -> Touch:
        """The touch in the image of `hand_out`, unknown if it does not come within `patience` s. Raises what the chain raised."""
        self._patience = patience
        self._is_late = self._is_late or not self._wait(patience)
        if self._is_late:
            why = f"{self.name} sensor: its perception process does not answer"
            return unknown_touch(image, now, Status(StatusCode.NO_ANSWER, why))
        return self._receive_value()

    def _call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        self._settle()
        self._send(name, *args, **kwargs)
        return self._receive_value()

    def _settle(self) -> None:
        """Take in answers that nobody waited for: that the chain is open, or those left by an interrupted cycle."""
        while self._due:
            ok, value = self._receive()
            if not ok:
                raise value

    def _send(self, name: str, *args: Any, **kwargs: Any) -> None:
        try:
            self._worker.connection.send((name, args, kwargs))
        except BlockingIOError as error:
            raise self._silent(REPLY_TIME) from error
        except OSError as error:
            raise self._lost() from error
        self._due += 1

    def _wait(self, patience: float) -> bool:
        """Whether there is an answer within `patience` s (or never will be, which `_receive` then says)."""
        try:
            return self._worker.connection.poll(patience)
        except OSError as error:
            raise self._lost() from error

    def _receive(self) -> tuple[bool, Any]:
        """The next answer: whether it is good, and the value or the error. Raises DeviceError when there is none."""
        patience = REPLY_TIME if self._is_ready else START_TIME
        for _ in range(patience):  # a second at a time: a computer that was suspended has lost one of them, not all
            if self._wait(1.0):
                break
            signals.check()
        else:
            raise self._silent(patience)
        try:
            answer = self._worker.connection.recv()
        except BlockingIOError as error:  # it stopped in the middle of an answer
            raise self._silent(REPLY_TIME) from error
        except (EOFError, OSError) as error:
            raise self._lost() from error
        self._due, self._is_ready = self._due - 1, True
        return answer

    def _receive_value(self) -> Any:
        ok, value = self._receive()
        if not ok:
            raise value
        return _sealed(value)

    def _silent(self, patience: int) -> DeviceError:
        return DeviceError(f"{self.name} sensor: its perception process did not answer for {patience} s")

    def _lost(self) -> DeviceError:
        return DeviceError(f"{self.name} sensor: its perception process ended ({self._worker.how_it_ended()})")


class _Worker:
    """A process that runs `serve`, this end of its socket, and the memory that it shares."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        # One that hangs does not empty the socket, and images do not fit into it.
        for side in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            ours.setsockopt(socket.SOL_SOCKET, side, struct.pack("ll", REPLY_TIME, 0))
        self.memory = os.fdopen(os.memfd_create("mjtactile-image"), "r+b")
        with theirs:
            descriptors = theirs.fileno(), self.memory.fileno()
            self._process = process.start(__name__, *descriptors, descriptors=descriptors, grace=0.0)
        self.connection = Connection(ours.detach())

    @property
    def pid(self) -> int:
        return self._process.pid

    def how_it_ended(self) -> str:
        return process.how_it_ended(self._process)

    def close(self) -> None:
        self.connection.close()
        self.memory.close()
        process.stop(self._process)


def serve(connection: Connection, memory: int) -> None:
    """Answer requests until the parent closes its end of the socket."""
    import cv2

    from mjtactile.sensing.chain import Perception

    cv2.setNumThreads(1)
    perception: Perception | None = None
    pixels = np.zeros((0, 0), np.uint8)
    while True:
        name, args, kwargs = connection.recv()
        try:
            if name == "open":
                perception = Perception.of(*args, **kwargs)
                shape = args[0].camera.height, args[0].camera.width
                pixels = np.frombuffer(mmap.mmap(memory, 0), np.uint8).reshape(shape)
                value = None
            elif name == "perceive_shared":
                value = perception.perceive(Image(pixels, args[0]), args[1])  # type: ignore[union-attr]  # `Image` copies
            else:
                value = getattr(perception, name)(*args, **kwargs)
            answer = True, value
        except Exception as error:  # noqa: BLE001  # every error is for the parent
            answer = False, _portable(error)
        connection.send(answer)


def _portable(error: Exception) -> Exception:
    """`error` as it can travel, with its traceback as a note."""
    error.add_note("in a perception process:\n" + "".join(traceback.format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001  # whatever its class did to itself
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _sealed(value: Any) -> Any:
    """`value` with its arrays read-only again, which pickle forgets."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, tuple):
        for item in value:
            _sealed(item)
    elif is_dataclass(value):
        for field in fields(value):
            _sealed(getattr(value, field.name))
    return value


def main() -> None:
    socket_fd, memory = map(int, sys.argv[1:])
    with contextlib.suppress(EOFError, OSError):  # the parent has gone
        serve(Connection(socket_fd), memory)
    os._exit(0)  # nothing to tidy up, and nobody waits


if __name__ == "__main__":
    main()
