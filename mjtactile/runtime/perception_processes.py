"""Perception in separate processes, for a simulated world that also needs the Python interpreter.

At the start of a run a process receives the sensing pipelines with their states, then images. At
the end of the run it returns the states. The result of a pipeline does not depend on where it runs
(docs/decisions/0024-perception-process-in-simulation.md). The only inputs are images and pressures.
"""

from __future__ import annotations

import contextlib
import pickle
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from mjtactile.core import platform_support, scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image, PressureReading, Touch
from mjtactile.runtime.perception_threads import (
    PATIENCE,
    Outcome,
    outcome_of,
    timeout_touch,
    value_of,
    with_readings,
)
from mjtactile.runtime.worker_process import Channel, WorkerProcess
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

_START = 120.0  # timeout, s; a busy computer takes 10 to import the pipeline's modules


class PerceptionPool:
    """Pool of `count` processes, started immediately; each handles every `count`-th finger.

    The pool must be closed. Raises OSError if the system cannot start so many processes.
    """

    def __init__(self, count: int) -> None:
        with contextlib.ExitStack() as close_on_failure:
            self._workers = [
                close_on_failure.enter_context(
                    contextlib.closing(WorkerProcess(__name__, "runs perception"))
                )
                for _ in range(count)
            ]
            self._started = close_on_failure.pop_all()
        self._perceptions: Sequence[Any] = ()
        self._names: Sequence[str] = ()

    @contextlib.contextmanager
    def using(self, perceptions: Sequence[Any], names: Sequence[str]) -> Iterator[PerceptionPool]:
        """Run these pipelines (`StatefulPipeline`) in the processes, starting from their current
        states.

        At the end the pipelines have the final states of the run. Raises DeviceError for a process
        that does not start.
        """
        self._perceptions = perceptions
        self._names = names
        for worker, part in self._parts(perceptions):
            # whole: arrays that may be written to have their address read faster
            worker.start("take", pickle.dumps(part))
        for worker, _ in self._parts(perceptions):
            if worker.outcome(_START) is None:
                raise DeviceError(
                    f"a process that runs perception has not started within {_START:g} s"
                )
        try:
            yield self
        finally:
            self._take_states()

    def perceive(
        self,
        images: Sequence[Image],
        now: float,
        timeout: float = PATIENCE,
        readings: Sequence[PressureReading | None] = (),
    ) -> tuple[Touch, ...]:
        """Estimate the touch of every sensor; see
        `mjtactile.runtime.perception_threads.Perceivers.perceive`.

        Raises DeviceError for a process that has ended. Raises the error of a pipeline after all
        have answered.
        """
        for worker, part in self._parts(with_readings(images, readings)):
            worker.start("perceive", part, now)
        end = scaled_clock.monotonic() + timeout
        outcomes = list[Outcome | None]([None] * len(images))
        for first, (worker, part) in enumerate(self._parts(self._perceptions)):
            answer = list[tuple[Outcome, Any]](
                worker.outcome(max(0.0, end - scaled_clock.monotonic())) or []
            )
            for finger, (perception, (outcome, tracks)) in enumerate(
                zip(part, answer, strict=False)
            ):
                outcomes[first + finger * len(self._workers)] = outcome
                # for display; the other parts of a state are large and not needed here
                if tracks is not None:
                    perception.state = replace(perception.state, tracks=tracks)
        return tuple(
            timeout_touch(name, image, now) if outcome is None else value_of(outcome)
            for outcome, name, image in zip(outcomes, self._names, images, strict=True)
        )

    def _take_states(self) -> None:
        """Retrieve the final states from the processes. Without an answer, initial states
        remain."""
        with contextlib.suppress(DeviceError):
            for worker, part in self._parts(self._perceptions):
                worker.start("give")
                for perception, state in zip(part, worker.outcome(PATIENCE) or (), strict=False):
                    perception.state = state

    def close(self) -> None:
        self._started.close()

    def _parts(self, values: Sequence[Any]) -> list[tuple[WorkerProcess, list[Any]]]:
        """Return each process that has work, with its part of `values`."""
        parts = [list(values[first :: len(self._workers)]) for first in range(len(self._workers))]
        return [(worker, part) for worker, part in zip(self._workers, parts, strict=True) if part]


def default_count(cameras: int) -> int:
    """Return the useful number of processes in addition to a simulated world.

    It is one per camera, limited by the number of processors.
    """
    return min(cameras, platform_support.processors() - 1)


def serve(channel: Channel) -> None:
    """Serve requests until the parent closes the channel: load pipelines, process images, return
    states."""
    perceptions: list[StatefulPipeline] = []
    with contextlib.suppress(OSError):
        while True:
            match channel.receive(None):
                case "take", own:
                    perceptions = pickle.loads(own)
                    channel.send()
                case "perceive", seen, now:
                    channel.send(
                        *[
                            (
                                outcome_of(perception.perceive, image, now, reading),
                                getattr(perception.state, "tracks", None),
                            )
                            for perception, (image, reading) in zip(perceptions, seen, strict=True)
                        ]
                    )
                case ("give",):
                    channel.send(*[perception.state for perception in perceptions])


if __name__ == "__main__":
    import cv2

    cv2.setNumThreads(1)  # the other processors are the world's
    serve(Channel.of(sys.argv[1]))
