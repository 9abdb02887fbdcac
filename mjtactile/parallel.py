"""Sensing chains in processes of their own, so that two fingers are felt at the same time and beside a simulated world.

Python computes in one thread of a process at a time. `Workers` starts processes that import what the chain needs while the
rig is being built; a `RemotePipeline` then stands in for the `SensorPipeline` of one sensor, and `perceive` hands every image
out before it waits for an answer. An image goes through shared memory, everything else through a socket. A worker runs the
same code on the same numbers, so that a run gives the same bits with and without it (docs/decisions/0006-a-process-a-sensor.md).
"""

from __future__ import annotations

import contextlib
import mmap
import os
import pickle
import signal
import socket
import subprocess
import sys
import traceback
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from mjtactile.design import SensorDesign
from mjtactile.errors import DeviceError
from mjtactile.types import Image, Touch

START_TIME = 60  # s for a worker to import everything, on a busy computer
REPLY_TIME = 10  # s for an answer; a chain needs a hundredth of a second for an image
_PARENT_TIME = 1.0  # s between two looks whether the parent still lives


class Chain(Protocol):
    """One sensor's chain from images to touch, wherever it runs; see `SensorPipeline`."""

    def take_flat(self, images: Sequence[Image]) -> Any: ...
    def take_rest(self, images: Sequence[Image], pressure_gauge: float, *, sealed: bool = True) -> Any: ...
    def perceive(self, image: Image, now: float) -> Touch: ...


def perceive(chains: Sequence[Chain], images: Sequence[Image], now: float) -> tuple[Touch, ...]:
    """What every sensor feels: all images are handed out first, then this process does its own share, then it collects."""
    pairs = list(zip(chains, images, strict=True))
    for chain, image in pairs:
        if isinstance(chain, RemotePipeline):
            chain.hand_out(image, now)
    own = [None if isinstance(chain, RemotePipeline) else chain.perceive(image, now) for chain, image in pairs]
    return tuple(chain.collect() if isinstance(chain, RemotePipeline) else cast(Touch, touch)
                 for (chain, _), touch in zip(pairs, own, strict=True))


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

    def chains(self, design: SensorDesign, names: Sequence[str]) -> list[Chain]:
        """One chain for each sensor of `names`; the last ones in the workers, the others in this process."""
        from mjtactile.sensing.pipeline import SensorPipeline

        own = max(len(names) - len(self._workers), 0)
        return [*(SensorPipeline(design) for _ in names[:own]),
                *(RemotePipeline(worker, design, name) for worker, name in zip(self._workers, names[own:], strict=False))]

    @property
    def pids(self) -> list[int]:
        return [worker.pid for worker in self._workers]

    def close(self) -> None:
        """End the processes; they keep nothing that would be lost."""
        for worker in self._workers:
            worker.close()


class RemotePipeline:
    """Stands in for the `SensorPipeline` of the sensor `name` ("left", "right") in a worker.

    Errors of the chain are raised here as they were raised there; one that ends, or does not answer, is a DeviceError.
    """

    def __init__(self, worker: _Worker, design: SensorDesign, name: str):
        self.design, self.name, self._worker = design, name, worker
        self._answers = 0  # that are due
        shape = design.camera.height, design.camera.width
        worker.memory.truncate(shape[0] * shape[1])
        self._pixels = np.frombuffer(mmap.mmap(worker.memory.fileno(), 0), np.uint8).reshape(shape)
        self._patience = START_TIME
        self._send("open", design)

    def take_flat(self, images: Sequence[Image]) -> Any:
        return self._call("take_flat", list(images))

    def take_rest(self, images: Sequence[Image], pressure_gauge: float, *, sealed: bool = True) -> Any:
        return self._call("take_rest", list(images), pressure_gauge, sealed=sealed)

    def perceive(self, image: Image, now: float) -> Touch:
        self.hand_out(image, now)
        return self.collect()

    def hand_out(self, image: Image, now: float) -> None:
        """Let the worker begin with an image; `collect` its touch before the next one."""
        self._settle()  # the shared memory is free when the last answer is here
        if image.pixels.shape == self._pixels.shape:
            self._pixels[:] = image.pixels
            self._send("perceive_shared", image.time, now)
        else:  # the chain says what is wrong with it
            self._send("perceive", image, now)

    def collect(self) -> Any:
        """The answer to the last request. Raises what the chain raised; DeviceError when the worker does not answer."""
        self._settle(leave=1)
        ok, value = self._receive()
        if not ok:
            raise value
        return _sealed(value)

    def _call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        self._settle()
        self._send(name, *args, **kwargs)
        return self.collect()

    def _settle(self, leave: int = 0) -> None:
        """Take in answers that nobody waited for: that the chain is open, or those left by an interrupted cycle."""
        while self._answers > leave:
            ok, value = self._receive()
            if not ok:
                raise value

    def _send(self, name: str, *args: Any, **kwargs: Any) -> None:
        try:
            self._worker.connection.send((name, args, kwargs))
        except OSError as error:
            raise self._lost() from error
        self._answers += 1

    def _receive(self) -> tuple[bool, Any]:
        try:
            # A second at a time: a computer that was suspended has lost one of them, not all.
            if not any(self._worker.connection.poll(1.0) for _ in range(self._patience)):
                raise DeviceError(f"{self.name} sensor: its perception process did not answer for {self._patience} s")
            answer = self._worker.connection.recv()
        except (EOFError, OSError) as error:
            raise self._lost() from error
        self._answers, self._patience = self._answers - 1, REPLY_TIME
        return answer

    def _lost(self) -> DeviceError:
        return DeviceError(f"{self.name} sensor: its perception process ended ({self._worker.obituary()})")


class _Worker:
    """A process that runs `serve`, this end of its socket, and the memory that it shares."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        self.memory = os.fdopen(os.memfd_create("mjtactile-image"), "r+b")
        home = str(Path(__file__).resolve().parents[1])
        path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        with theirs:
            # A new interpreter, not a fork: this one may have threads. A session of its own: Ctrl-C is for the parent.
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, str(theirs.fileno()), str(self.memory.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True,
                pass_fds=(theirs.fileno(), self.memory.fileno()), env={**os.environ, "PYTHONPATH": path, **one_thread})
        self.connection = Connection(ours.detach())

    @property
    def pid(self) -> int:
        return self._process.pid

    def obituary(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(0.2)  # its socket closes a moment before it can be waited for
        code = self._process.poll()
        return "its socket is closed" if code is None else f"by signal {-code}" if code < 0 else f"exit code {code}"

    def close(self) -> None:
        self.connection.close()
        self.memory.close()
        self._process.kill()
        self._process.wait()


def serve(connection: Connection, memory: int, parent: int) -> None:
    """Answer requests until the parent is gone: its end of the socket closes, or it is no longer the parent."""
    import cv2

    from mjtactile.sensing.pipeline import SensorPipeline

    cv2.setNumThreads(1)
    pipeline: SensorPipeline | None = None
    pixels = np.zeros((0, 0), np.uint8)
    while True:
        while not connection.poll(_PARENT_TIME):
            if os.getppid() != parent:
                return
        name, args, kwargs = connection.recv()
        try:
            if name == "open":
                pipeline = SensorPipeline(*args)
                shape = args[0].camera.height, args[0].camera.width
                pixels = np.frombuffer(mmap.mmap(memory, 0), np.uint8).reshape(shape)
                value = None
            elif name == "perceive_shared":
                value = pipeline.perceive(Image(pixels, args[0]), args[1])  # type: ignore[union-attr]  # `Image` copies
            else:
                value = getattr(pipeline, name)(*args, **kwargs)
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    socket_fd, memory, parent = map(int, sys.argv[1:])
    with contextlib.suppress(EOFError, OSError):  # the parent has gone
        serve(Connection(socket_fd), memory, parent)
    os._exit(0)  # nothing to tidy up, and nobody waits


if __name__ == "__main__":
    main()
