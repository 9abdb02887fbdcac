"""`load_recording` reads a recording back, however the run ended."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flags, read_flags
from mjtactile.core.signature_checks import not_below, shown, validated
from mjtactile.core.types import COMMAND_FIELDS, Array, Command, Image, ValveState
from mjtactile.recording.files import FORMAT, LOG, READABLE, VERSION, finger_names
from mjtactile.recording.log_file import (
    columns_of,
    is_image,
    keep_force_limit,
    left_out,
    read_image,
    read_rows,
    with_images,
    without_damaged_files,
)
from mjtactile.recording.log_schema import KEYS


@dataclass(frozen=True, eq=False)
class RecordedReference:
    """The images that a reference was taken from, and the chambers' gauge pressures, Pa (None: not
    measured)."""

    folder: Path
    stage: str
    names: Sequence[Sequence[str]]
    times: Sequence[Sequence[float]]
    gauge_pressure: Sequence[float | None]

    def images(self, finger: int) -> Iterator[Image]:
        """Yield the images of one finger. Raises InputError that names a missing or damaged
        file."""
        for name, time in zip(self.names[finger], self.times[finger], strict=True):
            yield read_image(self.folder / name, time)


@dataclass(frozen=True, eq=False)
class Recording:
    """Contents of a recording.

    Attributes:
        folder: Folder of the recording.
        header: Run configuration: object, sensor, controller, rig, seed, versions.
        notes: Facts outside the cycles, such as the fingers' names and the outcome of the run.
        columns: Values by key, one row per cycle; a JSON null is NaN.
        complete: True if the recording was closed properly.
        problems: Defects of the recording, one sentence each.
        references: Images from which the references were taken.
    """

    folder: Path
    header: Mapping[str, Any]
    notes: Mapping[str, Any]
    columns: Mapping[str, np.ndarray]
    complete: bool
    problems: tuple[str, ...]
    references: tuple[RecordedReference, ...] = ()

    @property
    def width(self) -> int:
        """Number of cameras."""
        return len(self.columns["image_time"][0]) if len(self) else 0

    @property
    def fingers(self) -> tuple[str, ...]:
        """Their names, in the order of every list of one value a finger."""
        return tuple(self.notes.get("fingers") or finger_names(self.width))

    @property
    def flags(self) -> Flags:
        """Flags of the recorded run by kind; their times are NaN in a recording from before
        0.2.0."""
        return read_flags(self.notes.get("flags", {}))

    def facts(self) -> dict[str, Any]:
        """Return names and outcome of the recorded run, for the results of a replay.

        Returns:
            The folder; object, task, sensor, controller, rig and seed; the outcome and the error;
            number of the recorded cycles. True if the recording was closed properly. Its defects.
            A name is None if the recording does not contain it.
        """
        scenario = self.header.get("scenario") or {}
        names = ("object", "task", "sensor", "controller", "rig", "seed")
        return {
            "folder": str(self.folder),
            **{name: self.header.get(name, scenario.get(name)) for name in names},
            **{name: self.notes.get(name) for name in ("outcome", "error")},
            "cycles": len(self),
            "complete": self.complete,
            "problems": list(self.problems),
        }

    @property
    def has_shapes(self) -> bool:
        """True if contact shapes were estimated; areas are then those of the shapes."""
        reported = self.columns.get("shape_kind", ())
        return any(kind != "none" for row in reported for kind in row)

    @property
    def has_shape_forces(self) -> bool:
        """True if forces and slip are those of the shapes. Recordings without this note are from
        versions in which shapes always changed them."""
        return bool(self.notes.get("contact_shapes", self.has_shapes))

    @property
    def valve_count(self) -> int:
        return len(self.columns["valve_open"][0]) if len(self) else 0

    def __len__(self) -> int:
        return len(self.columns["time"])

    def valves(self, cycle: int) -> tuple[ValveState, ...]:
        """Return the valve states of one cycle.

        Args:
            cycle: Index of the cycle, from 0.

        Returns:
            One state per valve, in the order of their fingers.
        """

        self._require_cycle(cycle)

        def number(key: str, finger: int) -> float:
            value = self.columns[key][cycle][finger] if key in self.columns else None
            return math.nan if value is None else float(value)

        gauges = [number("gauge_pressure", k) for k in range(self.valve_count)]
        return tuple(
            ValveState(
                bool(self.columns["valve_open"][cycle][k]),
                None if math.isnan(gauge) else gauge,
                number("valve_time", k),
                number("valve_age", k),
            )
            for k, gauge in enumerate(gauges)
        )

    def command(self, cycle: int) -> Command:
        """Return the command that was sent in one cycle.

        Args:
            cycle: Its number, from 0.

        Returns:
            The command. A field that an older recording lacks has its default, or None.

        Raises:
            InputError: The recording lacks the cycle or the opening, or has an unknown phase.
        """
        self._require_cycle(cycle)
        values: dict[str, Any] = {"opening": None, "force_limit": None}
        for name, entry in COMMAND_FIELDS.items():
            if entry.column in self.columns:
                values[name] = entry.read(self.columns[entry.column][cycle])
        try:
            return Command(**values)
        except InputError as error:
            message = f"cycle {cycle} has no valid command: {error}"
            raise InputError(message, source=self.folder) from error

    @validated(width=not_below(0))
    def column(self, key: str, width: int | None = None) -> Array:
        """Return a numeric column.

        Args:
            key: Name of the column (docs/reference/recording_format.md lists all).
            width: Width of the result if this recording lacks the column; by default one number per
                finger.

        Returns:
            (cycles, width), or (cycles, fingers, parts) for several numbers per finger. All values
            are NaN if this recording lacks the column, as for the ground truth of a real run.

        Raises:
            InputError: No recording has such a column, or it is not numeric (see `columns`).
        """
        if key not in self.columns:
            if key not in KEYS:
                raise InputError(f"no column {key!r}", source=self.folder, choices=KEYS)
            return np.full((len(self), width or self.width), np.nan)
        if not (len(self) and self.columns[key].dtype == object):
            return self.columns[key].reshape(len(self), *(self.columns[key].shape[1:] or (1,)))
        raise InputError(
            f"{key!r} is not a column of numbers; use columns[{key!r}]", source=self.folder
        )

    def _require_cycle(self, cycle: int) -> None:
        is_number = isinstance(cycle, (int, np.integer)) and not isinstance(cycle, bool)
        if not is_number or not 0 <= cycle < len(self):
            text = f"{shown(cycle)} is not the number of a cycle, 0 to {len(self) - 1}"
            raise InputError(text, source=self.folder, field="cycle")

    def require_images(self) -> None:
        """Check that every cycle has its images.

        Raises:
            InputError: Some have none.
        """
        have = sum(len(names) > 0 for names in self.columns["images"])
        if have < len(self):
            raise InputError(
                f"only {have} of {len(self)} cycles have images, and all are needed; record "
                "with --frames all",
                source=self.folder,
            )

    def phases(self) -> list[tuple[str, float, float]]:
        """List the phases of the run.

        Returns:
            In order: name, start and end, s.
        """
        names = self.columns["phase"]
        times = self.columns["time"]
        starts = [i for i in range(len(self)) if i == 0 or names[i] != names[i - 1]]
        ends = [*starts[1:], len(self) - 1]
        return [
            (str(names[a]), float(times[a]), float(times[b]))
            for a, b in zip(starts, ends, strict=True)
        ]

    def images(self) -> Iterator[tuple[Image, ...]]:
        """Read the camera images cycle by cycle.

        Returns:
            One image a finger for each cycle; () for a cycle without (`--frames`).

        Raises:
            InputError: A file is missing or broken.
        """
        return map(self.images_of, range(len(self)))

    def images_of(self, cycle: int) -> tuple[Image, ...]:
        """Read the camera images of one cycle.

        Args:
            cycle: Its number, from 0.

        Returns:
            One image per finger; () if the cycle has none.

        Raises:
            InputError: The recording lacks the cycle, or a file is missing or broken.
        """
        self._require_cycle(cycle)
        names = self.columns["images"][cycle]
        times = self.columns["image_time"][cycle]
        return tuple(read_image(self.folder / n, t) for n, t in zip(names, times, strict=False))


@validated()
def load_recording(path: str | Path) -> Recording:
    """Read a recording, even if its run was interrupted.

    Damaged lines, and cycles with a missing or damaged image, are left out. `problems` counts and
    names them. If no image is left, the log alone is read. In a reference, the nearest image of the
    same finger takes the place of a damaged one.

    Args:
        path: The recording's folder, or a run's folder around it.

    Returns:
        The recording.

    Raises:
        InputError: There is no recording, or it is of another version.
    """
    folder = Path(path)
    folder = folder / "recording" if foreign_file.is_dir(folder / "recording") else folder
    log = folder / LOG
    if not foreign_file.is_file(log):
        raise InputError(f"contains no recording: {LOG} is missing", source=folder)
    try:
        rows, problems = read_rows(log)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=log) from error
    header = rows[0] if rows else {}
    if header.get("format") != FORMAT or header.get("version") not in READABLE:
        found = f"{header.get('format')} version {header.get('version')}"
        if problems and header.get("kind") != "start":
            found = problems[0]
        raise InputError(
            f"{found}, expected {FORMAT} version {VERSION}", source=log, field="line 1"
        )
    header = without_damaged_files(header, problems)
    notes: dict[str, Any] = {}
    for row in rows:
        if row.get("kind") in ("note", "end"):
            notes |= {key: value for key, value in row.items() if key != "kind"}
    cycles, lost = with_images(folder, [row for row in rows if row.get("kind") == "cycle"])
    problems += lost
    complete = rows[-1].get("kind") == "end"
    if not complete:
        problems.append(f"cut off after {len(cycles)} cycles")
    columns = columns_of(cycles)
    if header["version"] == 1:
        keep_force_limit(columns)
    references = _references(folder, rows, problems)
    width = len(cycles[0]["image_time"]) if cycles else 0
    problems += _contradictions(notes, references, width)
    sound = tuple(reference for reference in references if not _differs(reference, width))
    return Recording(folder, header, notes, columns, complete, tuple(problems), sound)


def _references(
    folder: Path, rows: Sequence[Mapping[str, Any]], problems: list[str]
) -> list[RecordedReference]:
    """Return the references of the recording; add what is missing to `problems`."""
    references: list[RecordedReference] = []
    for row in rows:
        if row.get("kind") == "reference":
            reference, lost = _reference(folder, row)
            references += [] if reference is None else [reference]
            problems += lost
    return references


def _differs(reference: RecordedReference, width: int) -> bool:
    """Return True for another number of fingers than in the cycles; without images it has none."""
    return bool(width and reference.names) and len(reference.names) != width


def _contradictions(
    notes: dict[str, Any], references: Sequence[RecordedReference], width: int
) -> list[str]:
    """Remove and return notes and references of another number of fingers than the cycles."""
    if not width:
        return []
    found = [
        f"the reference {reference.stage!r} has {len(reference.names)} fingers, "
        f"the cycles {width}: left out"
        for reference in references
        if _differs(reference, width)
    ]
    names = notes.get("fingers")
    if names and len(names) != width:
        del notes["fingers"]
        found.append(f"{len(names)} names of fingers for {width} cameras: left out")
    return found


def _reference(folder: Path, row: Mapping[str, Any]) -> tuple[RecordedReference | None, list[str]]:
    """Return a reference, and its missing or damaged images as a problem.

    The nearest image of the same finger takes the place of a damaged one. Without any, there is no
    reference.
    """
    stage = row["stage"]
    names = [_replaced(folder, own) for own in row["images"]]
    damaged = [
        f"image {name} is missing or damaged"
        for own, new in zip(row["images"], names, strict=True)
        for k, name in enumerate(own)
        if new[k : k + 1] != [name]
    ]
    problems = left_out(f"images of the reference {stage!r}", damaged)
    if any(own and not new for own, new in zip(row["images"], names, strict=True)):
        return None, problems
    return RecordedReference(
        folder, stage, names, row["image_time"], row["gauge_pressure"]
    ), problems


def _replaced(folder: Path, names: Sequence[str]) -> list[str]:
    """Return the names with the nearest sound image in place of each damaged one."""
    sound = [k for k, name in enumerate(names) if is_image(folder / name)]
    if not sound:
        return []
    return [names[min(sound, key=lambda other: abs(other - k))] for k in range(len(names))]
