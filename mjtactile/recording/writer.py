"""`Recorder`: write the recording of a run in the background.

A thread writes the images of a cycle first and its log line last. All files that the log names are
therefore on disk.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import queue
import threading
import time as wall
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flags
from mjtactile.core.signature_checks import not_below, validated
from mjtactile.core.types import Image
from mjtactile.recording import png
from mjtactile.recording.decimated_history import DecimatedHistory
from mjtactile.recording.files import (
    FORMAT,
    FRAMES,
    LOG,
    VERSION,
    finger_names,
    provenance,
    to_json,
)
from mjtactile.recording.log_schema import CycleLike, make_row
from mjtactile.recording.mounting import Mounting
from mjtactile.recording.observer import Observer

# buffered cycles: 2 s at 30 Hz, 40 MB with two cameras of 640 x 480 pixels
_QUEUE_CYCLES = 64
_FLUSH_TIME = 5.0  # maximum wait for the disk at the end of a run, s
_logger = logging.getLogger(__name__)


@validated(frames=not_below(0))
class Recorder(Observer):
    """Observer that writes a recording during a run.

    It neither fails nor blocks a run. If writing fails or the disk stalls, the recording stops with
    a warning, and `problem` holds the reason. Use it as a context manager, or call `close` on every
    exit path.

    Args:
        folder: Destination; created if needed.
        header: Run configuration: object, sensor, controller, rig, seed.
        frames: Interval of cycles with stored images; 0: none.

    Raises:
        InputError: The folder already holds a recording, or cannot be written.
    """

    def __init__(self, folder: str | Path, header: Mapping[str, Any], *, frames: int = 1):
        self.folder = Path(folder)
        self.snapshot: CycleLike | None = None
        """The cycle to show: the latest of the hold phase, before that the one with the greatest
        force."""
        self.view: Any = None
        """The scene in that cycle."""
        self.views: list[tuple[float, Any]] | None = None
        """Time and scene of every cycle, if the caller sets a list."""
        self.strip: DecimatedHistory | None = None
        """Cycles spread over the run, if the caller sets a history."""
        self.cycles = self.references = 0
        self.flags: Flags = {}
        """Last noted reasons for reduced simulation accuracy."""
        self.problem = ""
        self.disk_wait_time = 10.0
        """Maximum time that `add` waits for a disk 64 cycles behind, s; 0 if the world does not
        wait."""
        self._frames = frames
        self._closed = False
        self._fingers: tuple[str, ...] = ()
        self._lock = threading.Lock()
        self._file = self._open()
        self._queue: queue.Queue[tuple[Mapping[str, Any], list[tuple[str, Image]]] | None] = (
            queue.Queue(_QUEUE_CYCLES)
        )
        self._thread = threading.Thread(target=self._write_loop, name="recorder", daemon=True)
        self._thread.start()
        self._enqueue(
            {
                "kind": "start",
                "format": FORMAT,
                "version": VERSION,
                "frames": frames,
                **header,
                **provenance(header),
            }
        )

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and self.never_started(error):
            self.discard()
        elif error is not None:
            self.close(outcome="fault", error=" ".join(str(error).split()) or type(error).__name__)
        self.close()

    def start(self, session: Any) -> None:
        """Set the time that this world waits for a slow disk. A real one does not wait.

        Args:
            session: The `Session`.
        """
        self.disk_wait_time = session.disk_wait_time

    def add(self, cycle: CycleLike, view: Any = None, **truth: Any) -> None:
        """Record one cycle.

        Args:
            cycle: Data of the cycle.
            view: The simulated scene at that time, kept (not written) for the figure.
            **truth: Ground-truth columns from a scorer.
        """
        if self.cycles == 0 and (last := getattr(cycle, "last", None)) is not None:
            self.note(start_opening=last.opening, start_lift_height=last.lift_height)
        if self.cycles == 0:
            self.note(unix_time_offset_s=wall.time() - cycle.time)
        kept = (
            self._frames
            and self.cycles % self._frames == 0
            and all(image.pixels.size for image in cycle.images)
        )
        images = []
        if kept:
            fingers = self._names(len(cycle.images))
            images = [
                (f"{FRAMES}/{self.cycles:06d}_{finger}.png", image)
                for finger, image in zip(fingers, cycle.images, strict=True)
            ]
        try:
            row = make_row(cycle, [name for name, _ in images], truth)
            if self.cycles == 0 and view is not None:
                self.note(mounting=Mounting.of_view(view, row).note())
        except Exception as error:  # noqa: BLE001  # any value that a controller stored in its memory
            self._stop_recording(error)
            return
        self._enqueue(row, images)
        self.cycles += 1
        if self.views is not None and view is not None:
            self.views.append((cycle.time, view))
        if self.strip is not None:
            self.strip.add(cycle, view)
        if self.snapshot is None or _worth_showing(cycle) >= _worth_showing(self.snapshot):
            self.snapshot = cycle
            self.view = view

    def add_reference(
        self, stage: str, images: Sequence[Sequence[Image]], gauge_pressure: Sequence[float | None]
    ) -> None:
        """Record the images of a reference.

        Args:
            stage: "flat" or "rest".
            images: One list a finger.
            gauge_pressure: Pa that they were taken at, for each valve; None: not measured.
        """
        named = []
        if self._frames and _has_pixels(images):
            named = [
                [(f"{FRAMES}/{stage}_{i:02d}_{finger}.png", image) for i, image in enumerate(shots)]
                for finger, shots in zip(self._names(len(images)), images, strict=True)
            ]
        self.references += 1
        self._enqueue(
            {
                "kind": "reference",
                "stage": stage,
                "images": [[name for name, _ in shots] for shots in named],
                "image_time": [[image.time for image in shots] for shots in images],
                "gauge_pressure": list(gauge_pressure),
            },
            [pair for shots in named for pair in shots],
        )

    def note(self, **facts: Any) -> None:
        """Record facts that are no cycle, such as `break_force_N`.

        Args:
            **facts: By name; `fingers` are the names that image files get.
        """
        self._fingers = tuple(facts.get("fingers", self._fingers))
        self.flags = facts.get("flags", self.flags)
        self._enqueue({"kind": "note", **facts})

    def _names(self, count: int) -> tuple[str, ...]:
        """Return the names of the fingers in file names.

        They are the noted names if all are valid in file names, else the default ones.
        """
        noted = {name for name in self._fingers if name and not {"/", "\0"} & set(name)}
        if len(noted) == len(self._fingers) == count:
            return self._fingers
        return finger_names(count)

    def close(self, **outcome: Any) -> None:
        """Write the queue and an `end` line; later calls do nothing.

        Args:
            **outcome: Outcome of the run, by name.
        """
        if self._closed:
            return
        self._closed = True
        self.disk_wait_time = _FLUSH_TIME
        self._enqueue({"kind": "end", **outcome})
        if not self.problem:
            with contextlib.suppress(queue.Full):
                self._queue.put(None, timeout=_FLUSH_TIME)
            self._thread.join(_FLUSH_TIME)
            if self._thread.is_alive():
                self._stop_recording("the disk does not respond")

    def never_started(self, error: BaseException) -> bool:
        """Return True if a run left no useful data, for example because a device was missing.

        Args:
            error: The error that ended it.

        Returns:
            True if its folder may be removed.
        """
        return self.cycles == 0 and (self.references == 0 or isinstance(error, InputError))

    def discard(self) -> None:
        """Close and remove the recording of a run that never started."""
        self.close()
        with contextlib.suppress(OSError):
            for path in (*(self.folder / FRAMES).glob("*.png"), self.folder / LOG):
                path.unlink()
            (self.folder / FRAMES).rmdir()
            self.folder.rmdir()

    def _open(self) -> TextIO:
        """Create the log. An existing log is an error, so the folder belongs to this recorder."""
        try:
            (self.folder / FRAMES).mkdir(parents=True, exist_ok=True)
            return (self.folder / LOG).open("x", encoding="utf-8")
        except FileExistsError as error:
            raise InputError(
                "already contains a recording; nothing is overwritten", source=self.folder
            ) from error
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", source=self.folder) from error

    def _enqueue(self, line: Mapping[str, Any], images: Sequence[tuple[str, Image]] = ()) -> None:
        if self.problem:
            return
        try:
            self._queue.put(
                (line, list(images)), block=self.disk_wait_time > 0, timeout=self.disk_wait_time
            )
        except queue.Full:
            self._stop_recording(f"the disk is {_QUEUE_CYCLES} cycles behind")

    def _stop_recording(self, why: object) -> None:
        """Stop recording and log a warning once."""
        if isinstance(why, Exception) and not isinstance(why, OSError):
            text = f"{type(why).__name__}: {why}"
        else:
            text = str(why)
        with self._lock:
            first = not self.problem
            self.problem = self.problem or " ".join(text.split())
        if first:
            _logger.warning("%s: the recording was stopped: %s", self.folder, self.problem)

    def _write_loop(self) -> None:
        """Write queued cycles in the background thread: images first, then the line that names
        them."""
        while not self.problem and (item := self._queue.get()) is not None:
            try:
                line, images = item
                for name, image in images:
                    (self.folder / name).write_bytes(png.encode(image.pixels))
                self._file.write(json.dumps(to_json(line), allow_nan=False) + "\n")
                self._file.flush()
            except Exception as error:  # noqa: BLE001
                # a full disk, a removed folder, a memory that contains itself
                self._stop_recording(error)
        with contextlib.suppress(OSError):  # buffered data that could not be written
            self._file.close()
        with contextlib.suppress(queue.Empty):  # unblock waiting producers
            while True:
                self._queue.get_nowait()


def _has_pixels(shots: Sequence[Sequence[Image]]) -> bool:
    """Return True for camera images, False for synthetic touch in their place."""
    return all(image.pixels.size for images in shots for image in images)


def _worth_showing(cycle: CycleLike) -> tuple[bool, float]:
    if cycle.sent.phase == "hold":
        return True, 0.0
    forces = [t.force_normal for t in cycle.touch if math.isfinite(t.force_normal)]
    return False, sum(forces) if forces else -math.inf
