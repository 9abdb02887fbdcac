"""Figure of a run, plotted by a process that imports matplotlib during the run."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile.core import platform_support
from mjtactile.core.errors import DeviceError, MjtactileError
from mjtactile.runtime.worker_process import Channel, WorkerProcess

if TYPE_CHECKING:  # imported by the run while this process starts
    from mjtactile.core.types import Array
    from mjtactile.recording.log_schema import CycleLike
    from mjtactile.recording.reader import Recording
    from mjtactile.report.software_renderer import SceneCamera

_PATIENCE = 60.0  # timeout of a figure on a busy computer, s


@dataclass(frozen=True, eq=False)
class _Still:
    """A `SceneCamera` without the model that it was taken of."""

    p_WS: Array
    R_WS: Array
    corners: Array
    rgba: Array
    item: Array | None

    def object_triangles(self) -> Array:
        assert self.item is not None  # used only with shapes
        return self.item

    def triangles(self) -> tuple[Array, Array]:
        return self.corners, self.rgba


def _still(scene: SceneCamera, snapshot: CycleLike | None) -> _Still:
    shaped = snapshot is not None and any(touch.shape is not None for touch in snapshot.touch)
    item = scene.object_triangles() if shaped else None
    return _Still(scene.p_WS, scene.R_WS, *scene.triangles(), item)


class FigureWriter:
    """`write_figure` in a worker process; in this process without a worker."""

    def __init__(self, worker: WorkerProcess | None):
        self._worker = worker

    def __call__(
        self,
        path: Path,
        recording: Recording,
        snapshot: CycleLike | None,
        summary: Mapping[str, Any],
        scene: SceneCamera | None = None,
    ) -> None:
        from mjtactile.report.summary_figure import write_figure
        from mjtactile.runtime.perception_threads import value_of

        if self._worker is None:
            write_figure(path, recording, snapshot, summary, scene)
            return
        still = None if scene is None else _still(scene, snapshot)
        try:
            self._worker.start(path, recording, snapshot, dict(summary), still)
            answer = self._worker.outcome(_PATIENCE)
        except DeviceError:
            write_figure(path, recording, snapshot, summary, scene)
            return
        if answer is None:
            raise MjtactileError(f"the figure took longer than {_PATIENCE:g} s")
        value_of((bool(answer[0]), answer[1]))


@contextlib.contextmanager
def figure_writer_process() -> Iterator[FigureWriter]:
    """Start a process that plots the figure of a run; yields its `FigureWriter`.

    With one processor, a second process saves no time: this process then plots the figure.
    """
    with contextlib.ExitStack() as stack:
        worker = None
        if platform_support.processors() == 1:
            yield FigureWriter(None)
            return
        with contextlib.suppress(OSError):  # no memory for another process
            worker = WorkerProcess(__name__, "renders the figure")
            stack.callback(worker.close)
        yield FigureWriter(worker)


def serve(channel: Channel) -> None:
    """Plot the requested figures until the parent closes the channel."""
    from mjtactile.report.summary_figure import import_matplotlib, write_figure
    from mjtactile.runtime.perception_threads import outcome_of

    with contextlib.suppress(MjtactileError):
        import_matplotlib()  # now: it takes as long as a figure
    with contextlib.suppress(OSError):
        while True:
            channel.send(*outcome_of(write_figure, *(channel.receive(None) or ())))


if __name__ == "__main__":
    serve(Channel.of(sys.argv[1]))
