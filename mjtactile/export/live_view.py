"""`LiveView`: live display of a run in Rerun or Foxglove."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Array
from mjtactile.export import messages
from mjtactile.export.episode import Perceived
from mjtactile.export.viewer_entities import EntityStream
from mjtactile.recording.log_schema import make_row
from mjtactile.recording.mounting import Mounting
from mjtactile.recording.observer import Observer
from mjtactile.report.overlay import followed

TARGETS = (
    *("rerun", "rerun:FILE.rrd", "rerun+http://HOST:9876/proxy"),
    *("foxglove", "foxglove:PORT", "foxglove:FILE.mcap"),
)
_MODULES = {"rerun": "rerun", "foxglove": "foxglove"}
_WAITING = 8  # cycles that wait for the viewer
_AGAIN = 1.0  # period after which static items are sent again, for late viewers, s
_FLUSH_TIME = 10.0  # wait for unsent items at the end of a run, s
_logger = logging.getLogger(__name__)


class Sink(Protocol):
    """Destination of items; `where`: address or file; `forgets`: late viewers miss old items."""

    where: str
    forgets: bool

    def log(self, item: messages.Message) -> None: ...
    def close(self) -> None: ...


@validated()
class LiveView(Observer):
    """Live display of images with ellipses, membranes, tractions, forces and the scene.

    It never fails or delays a run on real devices. A simulated world waits for a slow viewer; on a
    real rig cycles are dropped. A failing viewer is disabled with a warning. Use it as a context
    manager, or call `close`.

    Args:
        target: "rerun" (the open viewer, else a new one), "rerun:FILE.rrd",
            "rerun+http://HOST:9876/proxy" (a remote viewer), "foxglove" (a server on port 8765 that
            Foxglove connects to), "foxglove:PORT", "foxglove:FILE.mcap".
        notify: Callback that receives a line with the address or file to open.

    Raises:
        InputError: The target is unknown, the file exists, or a package is missing.
    """

    def __init__(self, target: str, notify: Callable[[str], None] = lambda _: None):
        self.viewer, self._to = _parsed(target)
        self.where = ""
        """Address or file to open; set when the run starts."""
        self.left_out = 0
        """Number of dropped cycles."""
        self.problem = ""
        self._patience = 0.0
        self._sink: Sink | None = None
        self._session: Any = None
        self._notify = notify
        self._queue: queue.Queue[Perceived | None] = queue.Queue(_WAITING)
        self._thread: threading.Thread | None = None

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self, session: Any) -> None:
        """Open the viewer, the server or the file.

        Args:
            session: The `Session`.
        """
        self._session = session
        self._patience = session.disk_wait_time
        source = _Running(session)
        self._sink = self._open(source.fingers)
        self.where = self._sink.where
        self._notify(self.where)
        self._thread = threading.Thread(
            target=self._work, args=(source, self._sink), name="live", daemon=True
        )
        self._thread.start()

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        """Show one cycle.

        Args:
            cycle: Images, touches and commands of the cycle.
            view: Scene at that time, in simulation only.
            **truth: Ground truth by column, in simulation only.
        """
        if self._thread is None or self.problem:
            return
        states = [getattr(perception, "state", None) for perception in self._session.perceptions]
        tracks = [getattr(state, "tracks", None) for state in states]
        row = make_row(cycle, (), truth)
        row = {key: value for key, value in row.items() if key not in ("kind", "images")}
        images = cycle.images if all(image.pixels.size for image in cycle.images) else ()
        ellipses = tuple(map(followed, cycle.images, tracks))
        seen = Perceived(cycle.time, row, images, (), cycle.touch, ellipses, view)
        try:
            self._queue.put(seen, block=self._patience > 0, timeout=self._patience)
        except queue.Full:
            self.left_out += 1

    def close(self) -> None:
        """Show the remaining cycles and close the viewer; later calls have no effect."""
        thread = self._thread
        self._thread = None
        if thread is not None and self._sink is not None:
            try:
                self._queue.put(None, timeout=_FLUSH_TIME)
            except queue.Full:
                return
            thread.join(_FLUSH_TIME)
            self._attempt(self._sink.close)

    def _open(self, fingers: tuple[str, ...]) -> Sink:
        if self.viewer == "foxglove":
            from mjtactile.export.foxglove_sink import FoxgloveFile, FoxgloveServer

            if isinstance(self._to, Path):
                return FoxgloveFile(self._to)
            return FoxgloveServer(int(self._to)) if self._to else FoxgloveServer()
        from mjtactile.export.rerun_sink import RerunSink, to_file, to_viewer

        sink = RerunSink(fingers)
        if isinstance(self._to, Path):
            to_file(sink, self._to)
        else:
            to_viewer(sink, self._to)
        return sink

    def _work(self, source: _Running, sink: Sink) -> None:
        """Process the queue in the background thread."""
        entities = EntityStream(source)
        sent = -np.inf
        while (seen := self._queue.get()) is not None:
            if self.problem:
                continue
            source.place(seen)
            is_first = sent < 0 or (sink.forgets and seen.time - sent >= _AGAIN)
            if is_first:
                sent = seen.time
                entities.again()
            self._attempt(
                lambda seen=seen, first=is_first: _show(sink, entities, seen, first=first)
            )

    def _attempt(self, act: Callable[[], None]) -> None:
        """Call a function that may fail; a viewer error does not stop the run."""
        try:
            act()
        except Exception as error:  # noqa: BLE001
            text = " ".join(f"{type(error).__name__}: {error}".split())
            if not self.problem:
                _logger.warning("the viewer was disabled after an error: %s", text)
            self.problem = self.problem or text


def _show(sink: Sink, entities: EntityStream, seen: Perceived, *, first: bool) -> None:
    """Send all items of one cycle; the `first` time also the camera poses."""
    source = entities.source
    if first:
        sink.log(messages.static(source, seen.time))
    for item in messages.of_cycle(source, seen):
        sink.log(item)
    for item in entities.of(seen):
        sink.log(item)


class _Running:
    """A run in progress, as a `messages.Source`."""

    def __init__(self, session: Any):
        self._session = session
        self._designs = {finger.name: _design(finger) for finger in session.rig.fingers}
        self._is_placed = False
        self.mounting = Mounting.assumed(len(self._designs))

    def place(self, seen: Perceived) -> None:
        """Take the mounting from the scene of the first cycle of a simulated rig."""
        if seen.view is not None and not self._is_placed:
            self._is_placed = True
            self.mounting = Mounting.of_view(seen.view, seen.row)

    @property
    def fingers(self) -> tuple[str, ...]:
        return tuple(self._designs)

    def design_of(self, finger: str) -> SensorDesign:
        """Return the design with the measured lens of this finger."""
        return self._designs[finger]

    @property
    def camera_poses(self) -> dict[str, tuple[Array, Array]]:
        """R_SC and p_SC of each finger's camera, of its flat reference or its sensor file."""
        poses = {}
        for pipeline, name in zip(self._session.perceptions, self.fingers, strict=True):
            flat = getattr(getattr(pipeline, "state", None), "flat", None)
            nominal = (np.eye(3), self._designs[name].camera.p_SC)
            poses[name] = nominal if flat is None else (flat.R_SC, flat.p_SC)
        return poses


def _design(finger: Any) -> SensorDesign:
    if finger.calibration is None:
        return finger.design
    return finger.calibration.used(finger.design).design(finger.design)


def _parsed(target: str) -> tuple[str, Path | str]:
    """Return the viewer, and its file, address or port, "" for the default. Raises InputError."""
    viewer, _, where = target.partition(":")
    if target.startswith("rerun+http"):
        viewer, where = "rerun", target
    if viewer not in _MODULES:
        raise InputError(f"{target!r} is not a viewer", field="--live", choices=TARGETS)
    if find_spec(_MODULES[viewer]) is None:
        raise InputError(
            f"{viewer}-sdk is not installed: pip install 'mjtactile[live]'", field="--live"
        )
    if not where or where.startswith("rerun+"):
        return viewer, where
    if viewer == "foxglove" and where.isdecimal():
        if int(where[:6]) > 65535:
            raise InputError(f"port {where[:20]} is not from 0 to 65535", field="--live")
        return viewer, where
    path = Path(where)
    suffix = {"rerun": ".rrd", "foxglove": ".mcap"}[viewer]
    if path.suffix != suffix:
        raise InputError(f"{where!r} does not end in {suffix}", field="--live", choices=TARGETS)
    if foreign_file.exists(path):
        raise InputError("exists already; nothing is overwritten", source=path, field="--live")
    if not foreign_file.is_dir(path.parent):
        raise InputError("no such folder", source=path.parent, field="--live")
    return viewer, path
