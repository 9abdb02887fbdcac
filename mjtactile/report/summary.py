"""Reports of a run, written in parallel.

The calling thread writes `summary.png` with matplotlib; a second thread writes `summary.html`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any

from mjtactile.core.errors import MjtactileError
from mjtactile.core.types import Image, Touch
from mjtactile.recording.log_schema import Seen
from mjtactile.recording.reader import Recording, load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.report.page import write_page
from mjtactile.report.summary_figure import write_figure
from mjtactile.runtime.re_estimation import replay_session, replay_touches
from mjtactile.runtime.session import Session
from mjtactile.sensing.stateful_pipeline import StatefulPipeline


def write_plots(
    folder: Path,
    recorder: Recorder,
    summary: Mapping[str, Any],
    figure: Callable[..., None] = write_figure,
) -> list[MjtactileError | OSError]:
    """Write the reports of the run that `recorder` wrote into `folder`.

    `figure` writes the PNG, for example in the process of `figure_writer_process`. Returns the
    errors, such as a missing matplotlib.
    """
    recording = load_recording(folder)
    strip = [] if recorder.strip is None else recorder.strip.kept
    problems: list[MjtactileError | OSError] = []
    with ThreadPoolExecutor(1, thread_name_prefix="page") as pool:
        page = pool.submit(
            write_page, folder / "summary.html", recording, strip, summary, recorder.snapshot
        )
        for write in (
            lambda: figure(
                folder / "summary.png", recording, recorder.snapshot, summary, recorder.view
            ),
            page.result,
        ):
            try:
                write()
            except (MjtactileError, OSError) as error:
                problems.append(error)
    return problems


@dataclass(frozen=True, eq=False)
class ReplayedCycle:
    """Recorded cycle with its images and the recomputed touch."""

    time: float
    images: tuple[Image, ...]
    touch: tuple[Touch, ...]


def replay_estimate(recording: Recording, on_cycle: Callable[[Seen], None]) -> bool:
    """Recompute the touch of all cycles with images, and pass each to `on_cycle`.

    Returns True if the touch could be recomputed. This requires the reference images and the images
    of all cycles. Raises InputError for a missing image or sensor file.
    """
    session = session_of(recording)
    touches = repeat(()) if session is None else replay_touches(recording, session)
    times = recording.column("time")[:, 0].tolist()
    for time, images, touch in zip(times, recording.images(), touches, strict=False):
        if images:
            on_cycle(ReplayedCycle(time, images, touch))
    return session is not None


def session_of(recording: Recording) -> Session | None:
    """Return a session with the references of a recording, or None if images are missing.

    Raises InputError for a missing image or sensor file.
    """
    if len(recording.references) < 2 or not all(len(n) for n in recording.columns["images"]):
        return None
    return replay_session(recording, contact_shapes=recording.has_shape_forces or None)


def with_shapes(recording: Recording, strip: Sequence[tuple[Seen, Any]]) -> list[tuple[Seen, Any]]:
    """Estimate each finger's contact shape in all cycles.

    An estimate takes some tenths of a second per touch.
    """
    session = session_of(recording)
    if session is None:
        return list(strip)
    found: list[tuple[Seen, Any]] = []
    for cycle, view in strip:
        touches = []
        for touch, pipeline in zip(cycle.touch, session.perceptions, strict=False):
            if touch.touching and isinstance(pipeline, StatefulPipeline):
                touch = replace(touch, shape=pipeline.shape([touch]))
            touches.append(touch)
        found.append((ReplayedCycle(cycle.time, tuple(cycle.images), tuple(touches)), view))
    return found
