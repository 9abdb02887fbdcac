"""Measurements of one sensor in recordings: static marker positions, pressure and volume over time,
images.

The images pass through the product's own sensing pipeline up to the markers
(`SensingPipeline.detect_markers`). Recorded force estimates and ground truth are not used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mjtactile.core.calibration import Calibration, calibration_from_table
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array, Image, Markers
from mjtactile.recording.reader import Recording, load_recording
from mjtactile.recording.stage_protocol import Move, Stage, protocol_indenter, stage_from_note
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.pose.flat_reference import FlatReference

_SETTLING = 0.3  # settling time between a move and its hold, s
_HOLD_MAX = 0.7  # averaging time at the end of a hold, s
_FEWEST = 5  # images of a hold
# relative height error of a correct lens; increase per residual of the flat membrane, 1/px
LENS_FRACTION = 0.003
_LENS_FRACTION_PER_PX = 0.1
# limit of the mean marker motion between the two halves of a hold, m; a larger motion rejects it
_MOVES_MAX = 5e-5
_WIDTHS = {"sphere": 2.0, "cylinder": 2.0, "box": 1.0}  # width of an indenter over its size

Notify = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Hold:
    """Static state of the sensor.

    `p_SM` (N, 3), m, are the mean marker positions in S (NaN: not visible). `cov` (N, 3, 3) is the
    covariance of that mean. The gauge pressure is in Pa (NaN: not measured). `move` is the
    preceding stage move, None for the rest state of the references. `time` is relative to the first
    cycle, s.
    """

    p_SM: Array
    cov: Array
    pressure: float
    move: Move | None
    time: float = math.nan

    @property
    def force(self) -> float:
        """Load cell reading, N; NaN: no reading, or a weight, which determines the depth."""
        return math.nan if self.move is None or self.move.is_weight else self.move.force

    @property
    def is_weighed(self) -> bool:
        return math.isfinite(self.force)


@dataclass(frozen=True, eq=False)
class Series:
    """Time series over all images with enough markers.

    `time`, s; gauge `pressure`, Pa (NaN: not measured); `volume` under the smoothed membrane
    surface, m^3.
    """

    time: Array
    pressure: Array
    volume: Array


@dataclass(frozen=True, eq=False)
class Evidence:
    """One recording of one finger.

    `stage` is None if no contact is known. `flat` are the reference's images. `height_fraction` is
    the standard deviation of a common relative error of all heights. It is larger where the flat
    membrane does not have the file's distance or leaves a residual: the lens may be wrong.
    """

    name: str
    stage: Stage | None
    rest: Hold
    holds: tuple[Hold, ...]
    series: Series
    flat: tuple[Image, ...]
    height_fraction: float = LENS_FRACTION

    @property
    def has_pressure(self) -> bool:
        return math.isfinite(self.rest.pressure)

    @property
    def states(self) -> tuple[Hold, ...]:
        """The rest and the holds."""
        return self.rest, *self.holds


def read_evidence(
    path: Path, design: SensorDesign, finger: str, notify: Notify = lambda _: None
) -> Evidence:
    """Read the measurements of `finger` from the recording in `path`.

    Raises InputError if references, images or the finger are missing.
    """
    recording = load_recording(path)
    if finger not in recording.fingers or len(recording.references) != 2:
        raise InputError(
            f"has no references of finger {finger!r}",
            source=path,
            field="--recording",
            choices=recording.fingers if len(recording.references) == 2 else None,
        )
    recording.require_images()
    finger_index = recording.fingers.index(finger)
    calibration = calibration_of(recording, design, finger)
    pipeline = SensingPipeline(design, calibration)
    flat, rest = recording.references
    flat_images = tuple(flat.images(finger_index))
    state = pipeline.measure_flat_reference(pipeline.initial_state(), flat_images)
    seen = [markers for _, markers in _detect(pipeline, state, rest.images(finger_index))]
    reading = rest.gauge_pressure[finger_index] if finger_index < len(rest.gauge_pressure) else None
    note = recording.notes.get("stage")
    is_own = note is not None and note.get("finger", finger) == finger
    stage = stage_from_note(note, path) if note is not None and is_own else None
    if stage is not None:
        _check_indenter(stage, design, path)
    notify(f"{path}: {len(recording)} images")
    expected = replace(state, expected=_latest(design, seen))
    times, shots = _follow(recording, finger_index, pipeline, expected)
    pressure = pressures_at(recording, finger_index, calibration, times)
    volumes = np.array([pipeline.fitter.fit(markers).volume for markers in shots])
    gauge = math.nan if reading is None else calibration.pressure(reading)
    at_rest = _hold(design, seen, gauge, None, math.nan)
    if at_rest is None:
        raise InputError("too few markers were detected at rest", source=path, field="--recording")
    return Evidence(
        str(path),
        stage,
        at_rest,
        tuple(_holds(design, stage, times, shots, pressure)),
        Series(times, pressure, volumes),
        flat_images,
        _height_fraction(design, state.flat),
    )


def _height_fraction(design: SensorDesign, flat: FlatReference) -> float:
    """Return the sd of a common relative error of all heights.

    A focal length error scales the estimated distance of the flat membrane and all heights alike.
    An error of the mounted distance has the same effect on the distance, none on the heights.
    """
    apparent = design.camera.distance - design.apparent_glass_thickness
    farther = float(flat.p_SC[2] - design.camera.p_SC[2])
    return max(LENS_FRACTION, _LENS_FRACTION_PER_PX * flat.residual_px, abs(farther) / apparent)


def _check_indenter(stage: Stage, design: SensorDesign, path: Path) -> None:
    """Raise InputError for an indenter wider than the frame's opening.

    It touches the frame, and its depth is then not the membrane's.
    """
    kind, _, size = stage.indenter.partition(":")
    if kind not in _WIDTHS:
        return  # a file: its width depends on the depth
    width = _WIDTHS[kind] * 1e-3 * float(size)
    side = min(design.frame.length, design.frame.width)
    if width > side + 1e-9 and any(move.touches for move in stage.moves):
        protocol = protocol_indenter("press", side)
        raise InputError(
            f"the indenter {stage.indenter} is {1e3 * width:g} mm wide, more than the frame's "
            f"opening of {1e3 * side:g} mm, and touches the frame; record it again with "
            f"{protocol} or another smaller one",
            source=path,
            field="--recording",
        )


def calibration_of(recording: Recording, design: SensorDesign, finger: str) -> Calibration:
    """Return the measured lens and the valve's zero.

    The camera pose is estimated again on the flat membrane.
    """
    table = recording.notes.get("calibration", {}).get(finger)
    if table is None:
        return Calibration(finger, design.name)
    return replace(calibration_from_table(table, str(recording.folder)), frame=None, force=None)


def _detect(
    pipeline: SensingPipeline, state: PipelineState, images: Iterator[Image]
) -> Iterator[tuple[Image, Markers]]:
    """Yield the images with enough markers, and these markers.

    The search starts at the positions in the previous image.
    """
    for image in images:
        markers, after = pipeline.detect_markers(state, image)
        if pipeline.check_markers(markers) == "ok":
            state = after
            yield image, markers


def _follow(
    recording: Recording, finger_index: int, pipeline: SensingPipeline, state: PipelineState
) -> tuple[Array, list[Markers]]:
    """Return the times after the first cycle, s, and the markers of the cycles' images."""
    found = list(_detect(pipeline, state, (images[finger_index] for images in recording.images())))
    start = float(recording.columns["time"][0]) if len(recording) else 0.0
    return np.array([image.time - start for image, _ in found]), [markers for _, markers in found]


def pressures_at(
    recording: Recording, finger_index: int, calibration: Calibration, times: Array
) -> Array:
    """Interpolate the valve board's gauge pressure readings at `times`, Pa; NaN without any."""
    readings = recording.column("gauge_pressure")
    when = recording.column("valve_time")
    if not len(recording) or finger_index >= recording.valve_count:
        return np.full(len(times), np.nan)
    start = float(recording.columns["time"][0])
    known = np.isfinite(readings[:, finger_index]) & np.isfinite(when[:, finger_index])
    if known.sum() < 2:
        return np.full(len(times), np.nan)
    gauge = np.array([calibration.pressure(float(p)) for p in readings[known, finger_index]])
    return np.interp(times, when[known, finger_index] - start, gauge)


def _latest(design: SensorDesign, seen: Sequence[Markers]) -> Array:
    expected = design.markers.p_SM.copy()
    for markers in seen[-1:]:
        expected[markers.ids] = markers.p_SM
    return expected


def _hold(
    design: SensorDesign, seen: Sequence[Markers], pressure: float, move: Move | None, time: float
) -> Hold | None:
    """Return the mean of the markers; None if there are too few images, or if the markers moved."""
    if len(seen) < _FEWEST:
        return None
    positions = np.full((len(seen), design.markers.count, 3), np.nan)
    total = np.zeros((design.markers.count, 3, 3))
    count = np.zeros(design.markers.count)
    for row, markers in zip(positions, seen, strict=True):
        row[markers.ids] = markers.p_SM
        total[markers.ids] += markers.cov_p
        count[markers.ids] += 1
    often = count >= len(seen) / 2
    mean = np.full((design.markers.count, 3), np.nan)
    cov = np.full((design.markers.count, 3, 3), np.nan)
    mean[often] = np.nanmean(positions[:, often], axis=0)
    cov[often] = total[often] / count[often, None, None] ** 2
    half = len(seen) // 2
    before, after = (np.nanmean(part[:, often], axis=0) for part in np.split(positions, [half]))
    if np.nanmean(np.abs(before - after)) > _MOVES_MAX:
        return None
    return Hold(mean, cov, pressure, move, time)


def _holds(
    design: SensorDesign,
    stage: Stage | None,
    times: Array,
    shots: Sequence[Markers],
    pressure: Array,
) -> Iterator[Hold]:
    """Yield the ends of the holds between the moves, and of the time before the first."""
    moves: tuple[Move | None, ...] = (None, *(stage.moves if stage else ()))
    last = float(times[-1]) if len(times) else 0.0
    ends = [*(min(move.time, last) for move in moves[1:] if move), last]
    before: Move | None = None
    for move, end in zip(moves, ends, strict=True):
        if move is not None and move.time >= last:
            break  # the recording ended before
        start = 0.0 if move is None else move.time + _travel(before, move) + _SETTLING
        rows = np.flatnonzero((times >= max(start, end - _HOLD_MAX)) & (times < end - 1e-6))
        gauge = float(np.mean(pressure[rows])) if len(rows) else math.nan
        time = float(times[rows].mean()) if len(rows) else math.nan
        hold = _hold(design, [shots[i] for i in rows.tolist()], gauge, move, time)
        if hold is not None:
            yield hold
        before = move


def _travel(before: Move | None, move: Move) -> float:
    """Return the duration of a move, s; a start without contact adds 3 mm."""
    lifted = -3e-3
    start, goal = (lifted if m is None or math.isnan(m.depth) else m.depth for m in (before, move))
    shear = 0.0 if before is None else before.shear
    return max(abs(goal - start), abs(move.shear - shear)) / move.speed
