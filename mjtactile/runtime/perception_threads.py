"""Parallel perception: the sensing pipelines of all fingers in threads, with a timeout.

The pipeline's kernels and MuJoCo release Python's lock while they compute, so threads use several
processors. Each pipeline is independent of the others. A run is therefore bit-identical for any
number of threads (docs/decisions/0017-perception-threads.md).
"""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

from mjtactile.core import platform_support, scaled_clock
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Image, PressureReading, SyntheticTouch, Touch

# Default timeout of a pipeline, s; it needs about 0.01 s for an image
PATIENCE = 10.0


class Perceiver(Protocol):
    """One sensor's perception; see `mjtactile.sensing.stateful_pipeline.StatefulPipeline`."""

    contact_shapes: bool | None

    def measure_flat_reference(self, images: Sequence[Image]) -> Any: ...
    def measure_rest_reference(
        self, images: Sequence[Image], gauge_pressure: float, *, sealed: bool = True
    ) -> Any: ...
    def perceive(
        self, image: Image, now: float, reading: PressureReading | None = None
    ) -> Touch: ...


class SyntheticPerception:
    """Replacement of a sensing pipeline for synthetic touch (`SyntheticTouch`), which it passes on.

    It does not provide contact shapes.
    """

    contact_shapes: bool | None = False
    state: Any = None

    def measure_flat_reference(self, images: Sequence[Image]) -> None: ...

    def measure_rest_reference(
        self, images: Sequence[Image], gauge_pressure: float, *, sealed: bool = True
    ) -> None: ...

    def perceive(self, image: Image, now: float, reading: PressureReading | None = None) -> Touch:
        assert isinstance(image, SyntheticTouch) and image.touch is not None
        touch = image.touch
        return touch if now == touch.time else replace(touch, age=now - touch.time)


class Perceivers:
    """Sensing pipelines of all fingers.

    The last `threads` of them (None: automatic) run in their own threads, the others in the
    caller's. `busy` is the number of other busy threads. It is a context manager and does not wait
    for a pipeline that hangs.
    """

    def __init__(
        self,
        pipelines: Sequence[Perceiver],
        names: Sequence[str],
        threads: int | None = None,
        *,
        busy: int = 0,
    ):
        threads = default_threads(len(pipelines), busy) if threads is None else threads
        in_caller = max(len(pipelines) - threads, 0)
        self._pipelines = [
            (pipeline, name, _Thread(name) if k >= in_caller else None)
            for k, (pipeline, name) in enumerate(zip(pipelines, names, strict=True))
        ]
        self._has_threads = in_caller < len(pipelines)

    def __enter__(self) -> Perceivers:
        return self

    def __exit__(self, *_: object) -> None:
        for entry in self._pipelines:
            if (thread := entry[2]) is not None:
                thread.close()

    def perceive(
        self,
        images: Sequence[Image],
        now: float,
        timeout: float = PATIENCE,
        readings: Sequence[PressureReading | None] = (),
    ) -> tuple[Touch, ...]:
        """Estimate the touch of every sensor, with the newest pressure readings if available.

        If a thread does not answer within `timeout`, s, its touch is unknown. It receives no
        other image until it has answered. Raises the error of a pipeline after all have ended.
        """
        if not self._has_threads:
            return self._run_in_turn(images, now, readings)
        pairs = list(zip(self._pipelines, images, strict=True))
        given = [(image, now, reading) for image, reading in with_readings(images, readings)]
        for (pipeline, _, thread), observed in zip(self._pipelines, given, strict=True):
            if thread is not None:
                thread.start(pipeline.perceive, *observed)
        outcomes = [
            outcome_of(pipeline.perceive, *observed) if thread is None else None
            for (pipeline, _, thread), observed in zip(self._pipelines, given, strict=True)
        ]
        end = scaled_clock.monotonic() + timeout
        found = [
            outcome if thread is None else thread.outcome(max(0.0, end - scaled_clock.monotonic()))
            for ((_, _, thread), _), outcome in zip(pairs, outcomes, strict=True)
        ]
        return tuple(
            timeout_touch(name, image, now) if outcome is None else value_of(outcome)
            for ((_, name, _), image), outcome in zip(pairs, found, strict=True)
        )

    def _run_in_turn(
        self, images: Sequence[Image], now: float, readings: Sequence[PressureReading | None]
    ) -> tuple[Touch, ...]:
        outcomes = [
            outcome_of(pipeline.perceive, image, now, reading)
            for (pipeline, _, _), (image, reading) in zip(
                self._pipelines, with_readings(images, readings), strict=True
            )
        ]
        return tuple([value_of(outcome) for outcome in outcomes])


def with_readings(
    images: Sequence[Image], readings: Sequence[PressureReading | None]
) -> list[tuple[Image, PressureReading | None]]:
    """Pair each image with its pressure reading, or None without readings."""
    return list(zip(images, readings or (None,) * len(images), strict=True))


def unknown_touch(image: Image, now: float, status: Status) -> Touch:
    """Return an unknown touch for `image`; `status` is the reason."""
    return Touch(image.time, now - image.time, math.nan, math.nan, False, status=status)


def default_threads(cameras: int = 2, busy: int = 0) -> int:
    """Return the useful number of threads in addition to `busy` others, such as a simulated
    world's.

    It is one per camera if there are processors for all of them, else zero.
    """
    return cameras if cameras > 1 and platform_support.processors() >= cameras + busy else 0


Outcome = tuple[bool, Any]
"""True for success, and the value or the error."""


class _Thread:
    """Worker that runs one call at a time. It is a daemon, so the process can exit while it
    hangs."""

    def __init__(self, name: str):
        self._work: queue.SimpleQueue[tuple[Callable[..., Any], tuple[Any, ...]] | None] = (
            queue.SimpleQueue()
        )
        self._done: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        self._due = 0
        self._is_late = False
        threading.Thread(target=self._run, name=f"perception {name}", daemon=True).start()

    def start(self, act: Callable[..., Any], *arguments: Any) -> None:
        """Start a call, unless the previous one is still running."""
        while self._due and not self._done.empty():
            self._done.get()  # discard the late result
            self._due -= 1
        self._is_late = self._due > 0
        if not self._is_late:
            self._work.put((act, arguments))
            self._due += 1

    def outcome(self, timeout: float) -> Outcome | None:
        """Return the outcome of the call; None if it did not end within `timeout`, s."""
        if self._is_late:
            return None
        try:
            done = self._done.get(timeout=scaled_clock.wall(timeout))
        except queue.Empty:
            return None
        self._due -= 1
        return done

    def close(self) -> None:
        self._work.put(None)

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            act, arguments = work
            self._done.put(outcome_of(act, *arguments))


def outcome_of(act: Callable[..., Any], *arguments: Any) -> Outcome:
    try:
        return True, act(*arguments)
    except Exception as error:  # noqa: BLE001  # every error is for the caller
        return False, error


def value_of(outcome: Outcome) -> Any:
    good, value = outcome
    if not good:
        raise value
    return value


def timeout_touch(name: str, image: Image, now: float) -> Touch:
    return unknown_touch(
        image,
        now,
        Status(StatusCode.PERCEPTION_TIMEOUT, f"{name} sensor: its perception does not answer"),
    )
