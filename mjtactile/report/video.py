"""Video of a run: the scene (if available), camera images with ellipses, and forces over time.

It also shows the estimated contact shape of each finger, if recorded. The video follows the run's
clock, independent of the cameras' rate. It is made from a recording, so it does not delay the run.
Scenes kept from a simulation are rendered without OpenGL (`software_renderer`).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array, Image
from mjtactile.recording.reader import Recording
from mjtactile.report.overlay import with_ellipses
from mjtactile.report.shape_cross_section import plot_section
from mjtactile.report.shape_wireframe import recorded_shape, true_lines
from mjtactile.report.software_renderer import SceneCamera, render_view
from mjtactile.report.summary_figure import FINGER_COLOURS, PHASE_COLOURS
from mjtactile.report.video_file import NOTE, Pixels, Writer, write_frames

FORMATS = {".mp4": (30.0, 1.0), ".gif": (10.0, 0.5), ".webp": (15.0, 0.5)}
"""Suffix to images a second and size."""
# Height of the images and of the curve, widths of scene and camera, px
_TOP = 480
_CURVE = 220
_SECTION = 150
_SCENE = 320
_CAMERA = 480
_MARGIN = 54  # px left of the curve, for its scale
_INK = (40, 40, 40)
_GRID = (225, 225, 225)
_PAPER = (255, 255, 255)
_MAX_FRAMES = 100_000
_SAME = 0.05  # maximum time between a scene and its cycle, s


def write_video(
    path: Path,
    recording: Recording,
    views: Sequence[tuple[float, SceneCamera]] = (),
    *,
    speed: float = 1.0,
    start: float = 0.0,
    seconds: float = math.inf,
    notify: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write a video of `recording` to `path` (.mp4, .gif or .webp).

    It plays `speed` times faster than the run and covers `seconds` from `start`, s, on. `views` are
    scenes with their times, s. Returns the number and the size of the frames.

    Raises InputError for another suffix or a recording without images, MjtactileError without
    PyAV.
    """
    if path.suffix not in FORMATS:
        raise InputError(
            f"{path.suffix or 'no suffix'!r} is not a supported video format",
            source=path,
            choices=FORMATS,
        )
    rate, scale = FORMATS[path.suffix]
    video = _VideoWriter(recording, views)
    times = video.times(start, seconds, speed, rate)
    part = path.with_name(path.name + ".part")
    size = (0, 0)
    with Writer(part, path.suffix, rate) as write:
        for k, time in enumerate(times):
            frame = video.frame(float(time))
            if scale != 1:
                frame = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            frame = frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]
            size = (frame.shape[1], frame.shape[0])
            write(np.ascontiguousarray(frame))
            if (k + 1) % 100 == 0:
                notify(f"{k + 1} of {len(times)} images")
    part.replace(path)
    return {
        "frames": len(times),
        "width_px": size[0],
        "height_px": size[1],
        "seconds": len(times) / rate,
    }


def is_own(path: Path) -> bool:
    """Return True if an earlier run wrote the .mp4; .gif and .webp carry no note."""
    try:
        import av

        with av.open(str(path)) as file:
            return file.metadata.get("comment") == NOTE
    except (ImportError, OSError, ValueError, EOFError):  # not a video
        return False


class _VideoWriter:
    """The frames of one recording."""

    def __init__(self, recording: Recording, views: Sequence[tuple[float, SceneCamera]]):
        if not len(recording) or not any(len(names) for names in recording.columns["images"]):
            raise InputError(
                "no image was recorded; record with --frames 1", source=recording.folder
            )
        self._recording = recording
        self._views = views
        self._view_times = [time for time, _ in views]
        self._time = recording.column("time")[:, 0]
        self.start = float(self._time[0])
        self.end = float(self._time[-1])
        self._images = (images for images in self._recording.images() if images)
        self._shown: list[Pixels] = []
        self._next: tuple[Image, ...] = next(self._images)
        self._scene: tuple[int, Pixels | None] = (-1, None)
        self._bodies: tuple[int, Pixels | None] = (-1, None)
        self._curve = _Curve(recording, self._width)

    @property
    def _width(self) -> int:
        return (_SCENE if self._views else 0) + _CAMERA * self._recording.width

    def frame(self, time: float) -> Pixels:
        """Render the BGR pixels at `time`, s. The time must not decrease between calls."""
        row = max(bisect.bisect_right(self._time, time + 1e-9) - 1, 0)
        images: tuple[Image, ...] = ()
        while self._next and (not self._shown or self._next[0].time <= time + 1e-9):
            images = self._next
            self._next = next(self._images, ())
            self._shown = self._shown or [with_ellipses(image, _CAMERA) for image in images]
        if images:
            self._shown = [with_ellipses(image, _CAMERA) for image in images]
        panels = [self._finger(k, pixels, row) for k, pixels in enumerate(self._shown)]
        if self._views:
            panels.insert(0, self._scene_at(time))
        parts = [np.hstack(panels), self._curve.at(time)]
        if self._recording.has_shape_forces:
            parts.insert(1, self._bodies_at(row))
        return np.vstack(parts)

    def times(self, start: float, seconds: float, speed: float, rate: float) -> Array:
        """Return the times of the images, s. Raises InputError for too many or none."""
        first = self.start + start
        duration = min(self.end, first + seconds) - first
        source = self._recording.folder
        if duration * rate / speed > _MAX_FRAMES:
            text = (
                f"{speed:g} makes a video of {duration * rate / speed:.2g} images; at most "
                f"{_MAX_FRAMES}, so at least {duration * rate / _MAX_FRAMES:.2g}"
            )
            raise InputError(text, source=source, field="--speed")
        times = np.arange(first, first + duration + 1e-9, speed / rate)
        if not len(times):
            text = f"the recording ends after {self.end - self.start:.1f} s"
            raise InputError(text, source=source, field="--start")
        return times

    def _bodies_at(self, row: int) -> Pixels:
        """Return the row of cross sections of the shapes, below the camera images."""
        if row == self._bodies[0] and self._bodies[1] is not None:
            return self._bodies[1]
        view = self._view_at(float(self._time[row]))
        canvas = np.full((_SECTION, self._width, 3), 255, np.uint8)
        left = _SCENE if self._views else 0
        for finger in range(self._recording.width):
            shape = recorded_shape(self._recording, row, finger)
            if shape is None or view is None:
                true = np.zeros((0, 2, 3))
            else:
                true = true_lines(shape, view, finger)
            part = canvas[:, left + finger * _CAMERA : left + (finger + 1) * _CAMERA]
            part[:] = plot_section(shape, true, (_SECTION, _CAMERA))
        self._bodies = (row, canvas)
        return canvas

    def _view_at(self, time: float) -> SceneCamera | None:
        """Return the stored scene at this time, or None."""
        index = max(bisect.bisect_right(self._view_times, time + 1e-9) - 1, 0)
        if not self._views or abs(self._view_times[index] - time) > _SAME:
            return None
        return self._views[index][1]

    def _finger(self, finger: int, canvas: Pixels, row: int) -> Pixels:
        """Return a camera image with the estimate below it."""
        panel = np.full((_TOP, _CAMERA, 3), 255, np.uint8)
        height = min(canvas.shape[0], _TOP - 84)
        panel[:height] = canvas[:height]
        columns = self._recording.columns
        force, sd = (
            float(self._recording.column(name)[row, finger])
            for name in ("force_normal", "force_normal_sd")
        )
        status = str(columns["status"][row][finger])
        if math.isfinite(force):
            estimated = f"{force:+.2f} N, sd {sd:.2f}"
        else:
            estimated = f"force unknown: {status}"
        slip = columns["slip_state"][row][finger] if "slip_state" in columns else "unknown"
        colour = _bgr(FINGER_COLOURS[finger % len(FINGER_COLOURS)])
        write_frames(
            panel,
            f"{self._recording.fingers[finger]}: {estimated}",
            (12, height + 32),
            0.8,
            colour,
            2,
        )
        write_frames(
            panel,
            f"{slip}" + ("" if status == "ok" else f"; {status}"),
            (12, height + 64),
            0.6,
            _INK,
        )
        return panel

    def _scene_at(self, time: float) -> Pixels:
        index = max(bisect.bisect_right(self._view_times, time + 1e-9) - 1, 0)
        if index != self._scene[0] or self._scene[1] is None:
            rgb = render_view(self._views[index][1], (_TOP, _SCENE))
            self._scene = (index, np.round(255 * rgb[:, :, ::-1]).astype(np.uint8))
        assert self._scene[1] is not None
        return self._scene[1]


class _Curve:
    """Force curves over the whole run, rendered once, with a line at the current time."""

    def __init__(self, recording: Recording, width: int):
        time = recording.column("time")[:, 0]
        estimated, sd, true = (
            recording.column(name)
            for name in ("force_normal", "force_normal_sd", "force_normal_true")
        )
        self._start = float(time[0])
        self._end = max(float(time[-1]), float(time[0]) + 1e-3)
        self._width = width
        maximum = np.nanmax(np.concatenate([estimated.ravel(), true.ravel(), [0.2]]))
        self._top = 1.3 * float(maximum)
        self._low = -0.1 * float(maximum)
        self._image = np.full((_CURVE, width, 3), 255, np.uint8)
        self._shade(recording)
        self._scale()
        for finger, colour in zip(
            range(estimated.shape[1]), map(_bgr, FINGER_COLOURS), strict=False
        ):
            self._band(time, estimated[:, finger], 2 * sd[:, finger], colour)
            self._line(time, estimated[:, finger], colour, 2)
            self._line(time, true[:, finger], tuple(int(0.55 * c) for c in colour), 1)
        known = "estimated, 2 sd" + ("; ground truth (thin)" if np.isfinite(true).any() else "")
        write_frames(self._image, f"normal force, N: {known}", (_MARGIN + 6, 16), 0.45, _INK)

    def at(self, time: float) -> Pixels:
        canvas = self._image.copy()
        x = int(self._x(np.array([time]))[0])
        cv2.line(canvas, (x, 22), (x, _CURVE - 24), _INK, 1)
        write_frames(
            canvas,
            f"{time - self._start:.1f} s",
            (min(x + 4, self._width - 52), _CURVE - 28),
            0.45,
            _INK,
        )
        return canvas

    def _x(self, time: Array) -> Array:
        return _MARGIN + (time - self._start) / (self._end - self._start) * (
            self._width - _MARGIN - 12
        )

    def _y(self, force: Array) -> Array:
        return 22 + (self._top - force) / (self._top - self._low) * (_CURVE - 46)

    def _shade(self, recording: Recording) -> None:
        for name, start, end in recording.phases():
            left, right = (int(x) for x in self._x(np.array([start, end])))
            cv2.rectangle(
                self._image,
                (left, 22),
                (right, _CURVE - 24),
                _bgr(PHASE_COLOURS.get(name, "#eeeeee")),
                -1,
            )
            if right - left > 9 * len(name):
                write_frames(self._image, name, (left + 4, _CURVE - 8), 0.45, _INK)

    def _scale(self) -> None:
        step = next(s for s in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 1e9) if self._top / s <= 5)
        for value in np.arange(0.0, self._top, step):
            y = int(self._y(np.array([value]))[0])
            cv2.line(self._image, (_MARGIN, y), (self._width - 12, y), _GRID, 1)
            write_frames(self._image, f"{value:g}", (10, y + 5), 0.45, _INK)

    def _band(self, time: Array, force: Array, half: Array, colour: tuple[int, ...]) -> None:
        known = np.isfinite(force) & np.isfinite(half)
        if known.sum() < 2:
            return
        x = self._x(time[known])
        outline = np.concatenate(
            [
                np.stack([x, self._y((force + half)[known])], axis=1),
                np.stack([x, self._y((force - half)[known])], axis=1)[::-1],
            ]
        )
        over = self._image.copy()
        cv2.fillPoly(over, [np.round(outline).astype(np.int32)], colour)
        self._image[:] = cv2.addWeighted(over, 0.2, self._image, 0.8, 0)

    def _line(self, time: Array, force: Array, colour: tuple[int, ...], width: int) -> None:
        """Plot a line with gaps at unknown forces."""
        points = np.round(np.stack([self._x(time), self._y(np.nan_to_num(force))], axis=1)).astype(
            np.int32
        )
        for run in np.split(
            np.arange(len(force)), np.flatnonzero(np.diff(np.isfinite(force).astype(int))) + 1
        ):
            if len(run) and np.isfinite(force[run[0]]):
                cv2.polylines(self._image, [points[run]], False, colour, width, cv2.LINE_AA)


def _bgr(colour: str) -> tuple[int, int, int]:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return blue, green, red
