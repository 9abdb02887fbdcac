"""Episode to export: a recording, its sensors, and touches estimated again from its images.

A recording contains no surface and no markers. If all images are available, the sensing pipeline
processes them again, like a replay.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.calibration import Calibration, calibration_from_table, pressure_reading
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError, InputError, MjtactileError
from mjtactile.core.task import load_task
from mjtactile.core.types import Array, Ellipses, Image, PressureReading, Touch
from mjtactile.export.effective_camera import RESIDUAL_MAX, effective_camera
from mjtactile.recording.files import LOG, RECORDINGS, to_json
from mjtactile.recording.log_schema import SENSED, TRUE
from mjtactile.recording.mounting import Mounting
from mjtactile.recording.policy_data import PolicyData, policy_data
from mjtactile.recording.reader import Recording, load_recording
from mjtactile.recording.recorded_sensors import recorded_sensors
from mjtactile.report.overlay import followed
from mjtactile.runtime.re_estimation import zeroed_pipeline
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

T = TypeVar("T")
U = TypeVar("U")
NOT_OF_A_FINGER = ("object_position_true", "object_quaternion_true")
"""Columns of several values that are not one set per finger."""
_PLAIN_TASK = "lift"
LISTS = ("patches", "shape_outline")
"""Columns with a variable number of entries per finger."""
_PARTS = {
    "wrench": ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"),
    "contact_area_interval": ("low_m2", "high_m2"),
    "contact_centroid": ("x_m", "y_m"),
    "slip_velocity": ("x_m_s", "y_m_s"),
    "shape_area_interval": ("from_m2", "to_m2"),
    "shape_curvatures": ("larger_1_m", "smaller_1_m"),
    "shape_place": ("x_m", "y_m", "z_m"),
    "shape_rolling": ("x_rad_s", "y_rad_s"),
    "shape_sliding": ("x_m_s", "y_m_s"),
    "object_position_true": ("x_m", "y_m", "z_m"),
    "object_quaternion_true": ("w", "x", "y", "z"),
}
_PARTS |= dict.fromkeys(("wrench_sd", "wrench_true"), _PARTS["wrench"])


@dataclass(frozen=True, eq=False)
class Perceived:
    """One cycle of an episode: the log's `row`, stored images, and re-estimated touches, if any.

    `ellipses` are the tracked ones of each image; `view` is the scene of a live simulated run;
    `cycle` is the index in a recording.
    """

    time: float
    row: Mapping[str, Any]
    images: tuple[Image, ...]
    files: tuple[Path, ...]
    touch: tuple[Touch, ...]
    ellipses: tuple[Ellipses | None, ...] = ()
    view: Any = None
    cycle: int = -1


class RecordedEpisode:
    """A recording with its `design` and calibrations. Raises InputError if it has no cycles."""

    def __init__(self, folder: Path):
        self.recording: Recording = load_recording(folder)
        if not len(self.recording):
            raise InputError("has no cycles to export", source=folder)
        self._designs = recorded_sensors(self.recording)
        self.design = next(iter(self._designs.values()))
        self.estimate_difference = math.nan
        """Largest difference of re-estimated and recorded normal forces, cycles read so far, N."""
        tables = self.recording.notes.get("calibration", {})
        self.calibrations: dict[str, Calibration | None] = {
            name: calibration_from_table(tables[name], str(folder)) if name in tables else None
            for name in self.fingers
        }

    @property
    def fingers(self) -> tuple[str, ...]:
        return self.recording.fingers

    @property
    def re_estimate(self) -> bool:
        """True if the sensing pipeline processes the images of this recording again."""
        return bool(self._perceptions)

    @property
    def rate(self) -> float:
        """Cycles a second, median."""
        times = self.recording.columns["time"]
        if len(times) > 1:
            return 1.0 / float(np.median(np.diff(times)))
        return self.design.camera.rate

    @property
    def keys(self) -> tuple[str, ...]:
        """Columns of this recording, except for its images' names."""
        return tuple(key for key in (*SENSED, *TRUE) if key in self.recording.columns)

    @property
    def task(self) -> str:
        """Description of the task in words."""
        header = self.recording.header
        if not header.get("object"):
            return "record"
        name = Path(header["object"]).stem.replace("_", " ")
        words = "grasp an unknown object" if name.startswith("random:") else f"grasp the {name}"
        scenario = header.get("scenario")
        task = scenario.get("task") if isinstance(scenario, Mapping) else None
        return words if task in (None, _PLAIN_TASK) else f"{words}: {_task_description(task)}"

    @property
    def outcome(self) -> str:
        """Outcome of the run; "" if it is unknown."""
        return str(self.recording.notes.get("outcome") or "")

    @cached_property
    def policy(self) -> PolicyData:
        """Observations and actions for a policy."""
        return policy_data(self.recording)

    @property
    def facts(self) -> dict[str, Any]:
        """Metadata of the recording: header with versions and files, notes, problems."""
        recording = self.recording
        return to_json(
            {
                "header": recording.header,
                "notes": recording.notes,
                "complete": recording.complete,
                "problems": recording.problems,
                "fingers": self.fingers,
                "cycles": len(recording),
                "re_estimate": self.re_estimate,
                "recomputed_difference_N": self.estimate_difference,
                "camera_in_sensor": {
                    name: {"R_SC": R.tolist(), "p_SC_m": p.tolist()}
                    for name, (R, p) in self.camera_poses.items()
                },
                "effective_camera": {name: self._effective_camera(name) for name in self.fingers},
                "mounting": self.mounting.note(),
            }
        )

    def _effective_camera(self, finger: str) -> dict[str, Any]:
        """Return the camera without a glass that replaces the finger's camera behind it."""
        found = effective_camera(self.design_of(finger))
        return {**found.camera.intrinsics, "shift_m": found.shift, "residual_px": found.residual_px}

    @property
    def camera_problems(self) -> list[str]:
        """Return a statement for each finger whose effective camera is not accurate."""
        residuals = {name: self._effective_camera(name)["residual_px"] for name in self.fingers}
        return [
            f"camera {name}: points project up to {residual:.1f} px off (limit {RESIDUAL_MAX:g} "
            "px): CameraInfo has no glass; use camera_in_sensor of the metadata and the glass of "
            "the sensor file"
            for name, residual in residuals.items()
            if residual > RESIDUAL_MAX
        ]

    @property
    def mounting(self) -> Mounting:
        """Poses of gripper and sensors: as recorded, otherwise assumed."""
        return Mounting.of_note(self.recording.notes.get("mounting"), len(self.fingers))

    @property
    def files(self) -> dict[str, str]:
        """Texts of the sensor and rig files and of calibrations, by file name."""
        stored = self.recording.header.get("files", {}).items()
        notes = self.recording.notes.get("calibration", {}).items()
        suffixes = {"controller": ".py"}
        return {f"{kind}{suffixes.get(kind, '.toml')}": file["text"] for kind, file in stored} | {
            f"calibration_{name}.json": json.dumps(table, indent=1) for name, table in notes
        }

    @property
    def references(self) -> dict[str, Path]:
        """Images of the references, by name."""
        references = self.recording.references
        paths = [r.folder / name for r in references for names in r.names for name in names]
        return {path.name: path for path in paths if foreign_file.is_file(path)}

    def design_of(self, finger: str) -> SensorDesign:
        """Return the design with the measured lens of this finger."""
        calibration = self.calibrations[finger]
        design = self._designs[finger]
        return design if calibration is None else calibration.used(design).design(design)

    @property
    def camera_poses(self) -> dict[str, tuple[Array, Array]]:
        """`R_SC` (3, 3) and `p_SC` (3,), m, of each finger's camera.

        They are of the flat reference, otherwise of the calibration or the sensor file.
        """
        return self._camera_poses

    @cached_property
    def _camera_poses(self) -> dict[str, tuple[Array, Array]]:
        return {name: self._camera_pose(k, name) for k, name in enumerate(self.fingers)}

    def _camera_pose(self, index: int, finger: str) -> tuple[Array, Array]:
        calibration = self.calibrations[finger]
        if self._perceptions:
            flat = self._perceptions[index].state.flat
            return flat.R_SC, flat.p_SC
        design = self._designs[finger]
        if calibration is not None and (frame := calibration.used(design).frame) is not None:
            return frame.R_SC, frame.p_SC
        return np.eye(3), design.camera.p_SC

    @cached_property
    def _perceptions(self) -> tuple[StatefulPipeline, ...]:
        """Sensing pipelines of the fingers; () if the recording does not contain all images."""
        recording = self.recording
        if len(recording.references) != 2 or not all(map(len, recording.columns["images"])):
            return ()
        flat, rest = recording.references
        try:
            fingers = enumerate(self.fingers)
            return tuple(self._perception(k, name, flat, rest) for k, name in fingers)
        except (DeviceError, InputError):  # a cut-off reference; the log is exported anyway
            return ()

    def _perception(self, index: int, finger: str, flat: Any, rest: Any) -> StatefulPipeline:
        reading = rest.gauge_pressure[index] if index < len(rest.gauge_pressure) else None
        perception = zeroed_pipeline(
            self._designs[finger],
            self.calibrations[finger],
            list(flat.images(index)),
            list(rest.images(index)),
            reading,
        )
        perception.contact_shapes = self.recording.has_shape_forces or None
        return perception

    def _readings(self, cycle: int) -> list[PressureReading | None]:
        """Return the pressure readings of that cycle, for each finger."""
        valves = dict(zip(self.fingers, self.recording.valves(cycle), strict=False))
        return [
            pressure_reading(valves[name], self.calibrations[name]) if name in valves else None
            for name in self.fingers
        ]

    def cycles(self) -> Iterator[Perceived]:
        """Yield all cycles in order. Raises InputError for a missing or damaged image file."""
        columns = self.recording.columns
        folder = self.recording.folder
        for k, images in enumerate(self.recording.images()):
            row = {key: columns[key][k] for key in self.keys}
            time = float(row["time"])
            pairs = list(zip(self._perceptions, images, strict=False))
            readings = self._readings(k)[: len(pairs)]
            touch = tuple(
                pipeline.perceive(image, time, reading)
                for (pipeline, image), reading in zip(pairs, readings, strict=True)
            )
            for estimate, recorded in zip(touch, row["force_normal"], strict=False):
                difference = abs(estimate.force_normal - recorded)
                self.estimate_difference = float(np.fmax(self.estimate_difference, difference))
            files = tuple(folder / name for name in columns["images"][k])
            ellipses = tuple(
                followed(image, finger_pipeline.state.tracks) for finger_pipeline, image in pairs
            )
            yield Perceived(time, row, images, files, touch, ellipses, cycle=k)


def find_episodes(
    path: Path, leave_out: Callable[[str], None] = lambda _: None, *, outcome: str | None = None
) -> list[RecordedEpisode]:
    """Return the recording in `path`, or all recordings in its subfolders, sorted by name.

    For an evaluation, these are its episodes, without those repeated for images. A recording that
    cannot be read is left out, and `leave_out` receives the reason. An `outcome` selects those
    with it. Raises InputError if there are none.
    """
    within = path / RECORDINGS if foreign_file.is_dir(path / RECORDINGS) else path
    if foreign_file.is_file(path / LOG) or foreign_file.is_file(path / "recording" / LOG):
        folders = [path]
    else:
        folders = sorted(log.parent for log in within.rglob(LOG))
    if not folders:
        message = "contains no recording; an evaluation keeps recordings with --record"
        raise InputError(message, source=path, field="RUN")
    found = with_each(folders, RecordedEpisode, leave_out)
    chosen = [episode for episode in found if outcome in (None, episode.outcome)]
    if not chosen:
        outcomes = sorted({episode.outcome or "unknown" for episode in found})
        text = f"no recording has the outcome {outcome!r}"
        raise InputError(text, source=path, field="--outcome", choices=outcomes)
    return chosen


def with_each(
    inputs: Iterable[T], job: Callable[[T], U], leave_out: Callable[[str], None]
) -> list[U]:
    """Return the result of a job for each input that does not fail.

    `leave_out` receives the reasons of the others. Raises the first of them if there is no result.
    """
    results: list[U] = []
    first: MjtactileError | None = None
    for one in inputs:
        try:
            results.append(job(one))
        except MjtactileError as error:
            first = first or error
            leave_out(" ".join(str(error).split()))
    if first is not None and not results:
        raise first
    return results


def write_each(
    episodes: Sequence[RecordedEpisode],
    out: Path,
    suffix: str,
    write_one: Callable[[Path, RecordedEpisode], None],
    *,
    notify: Callable[[str], None],
    leave_out: Callable[[str], None],
) -> dict[str, Any]:
    """Write `episode_000000`, with `suffix`, and so on; return the number of episodes and frames.

    An episode that cannot be written is left out, and `leave_out` receives the reason.
    """
    frames: list[int] = []

    def write(episode: RecordedEpisode) -> None:
        notify(f"{len(frames) + 1} of {len(episodes)}: {episode.recording.folder}")
        path = out / f"episode_{len(frames):06d}{suffix}"
        try:
            write_one(path, episode)
        except MjtactileError:
            shutil.rmtree(path, ignore_errors=True)  # a folder
            path.unlink(missing_ok=True)
            raise
        frames.append(len(episode.recording))

    with_each(episodes, write, leave_out)
    return {"episodes": len(frames), "frames": sum(frames)}


def part_names(episode: RecordedEpisode, key: str) -> list[str]:
    """Return a name with unit for each value of a column, left to right."""
    unit = (SENSED[key][0] if key in SENSED else TRUE[key][0]).replace("^", "").replace("/", "_")
    names_of_parts = _PARTS.get(key, (unit or key,))
    column = episode.recording.columns[key]
    if key in NOT_OF_A_FINGER:
        return list(names_of_parts)
    if column.ndim == 1 and column.dtype != object:
        return [f"{key}_{unit}" if unit else key]
    parts = episode.fingers if column.shape[1] == len(episode.fingers) else range(column.shape[1])
    return [f"{part}.{name}" for part in parts for name in names_of_parts]


def meanings() -> dict[str, dict[str, str]]:
    """Return unit and meaning of every column."""
    return {
        key: {"unit": unit, "meaning": text}
        for key, (unit, text, *_) in (*SENSED.items(), *TRUE.items())
    }


def _task_description(task: str) -> str:
    """Return the description of a task, or its name if its file is missing."""
    try:
        return load_task(task).about
    except InputError:
        return Path(task).stem
