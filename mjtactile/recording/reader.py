"""`load_recording` reads a recording back, however the run ended."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flags, read_flags
from mjtactile.core.image_decoding import decode, is_sound, read_file
from mjtactile.core.renamed import current_row
from mjtactile.core.signature_checks import not_below, shown, validated
from mjtactile.core.types import COMMAND_FIELDS, Array, Command, Image, ValveState
from mjtactile.recording.files import FORMAT, LOG, READABLE, VERSION, finger_names
from mjtactile.recording.log_schema import KEYS
from mjtactile.recording.log_validation import has_its_checksum, wrong_column, wrong_note


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
        """The images of one finger. Raises InputError naming a file that is missing or broken."""
        for name, time in zip(self.names[finger], self.times[finger], strict=True):
            yield _read_image(self.folder / name, time)


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
        """True if contact shapes were estimated; areas and forces are then those of the shapes."""
        reported = self.columns.get("shape_kind", ())
        return any(kind != "none" for row in reported for kind in row)

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
        """See that every cycle has its images.

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
        return tuple(_read_image(self.folder / n, t) for n, t in zip(names, times, strict=False))


def _read_image(path: Path, time: float) -> Image:
    pixels = decode(read_file(path), cv2.IMREAD_GRAYSCALE) if _is_image(path) else None
    if pixels is None:
        raise InputError("missing or broken image", source=path)
    return Image(pixels.astype(np.uint8), time)


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
        rows, problems = _parse(log)
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
    header = _without_damaged_files(header, problems)
    notes: dict[str, Any] = {}
    for row in rows:
        if row.get("kind") in ("note", "end"):
            notes |= {key: value for key, value in row.items() if key != "kind"}
    cycles, lost = _with_images(folder, [row for row in rows if row.get("kind") == "cycle"])
    problems += lost
    complete = rows[-1].get("kind") == "end"
    if not complete:
        problems.append(f"cut off after {len(cycles)} cycles")
    columns = _columns(cycles)
    if header["version"] == 1:
        _keep_force_limit(columns)
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
    """Return notes and references of another number of fingers than the cycles; take them out."""
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


def _without_damaged_files(header: Mapping[str, Any], problems: list[str]) -> dict[str, Any]:
    """Return the header without files whose text does not have its checksum; name them."""
    files = header.get("files", {})
    sound = {kind: file for kind, file in files.items() if has_its_checksum(file)}
    problems += [
        f"line 1: the text of the {k} file is corrupt and was ignored"
        for k in files
        if k not in sound
    ]
    return {**header, **({"files": sound} if files else {})}


def _keep_force_limit(columns: dict[str, np.ndarray]) -> None:
    """Put the limit in force where version 1 has 0, which meant "as before"; NaN before any."""
    limits = columns.get("command_force_limit")
    if limits is None:
        return
    limit = math.nan
    for k, value in enumerate(limits):
        limit = value if value > 0 else limit
        limits[k] = limit


_LINE_MAX = 1 << 24  # maximum length of a line, bytes
_NAMED = 3  # damaged lines or cycles in a message


def _parse(log: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Return every line that is whole, and the numbers of the others as a problem."""
    rows: list[dict[str, Any]] = []
    damaged: list[str] = []
    first: dict[str, Any] = {}
    if not foreign_file.is_file(log):
        raise InputError("is not a regular file", source=log)
    with log.open("rb") as file:
        for number, line in enumerate(_lines(file), 1):
            row = None
            # a longer line cannot be a cycle
            with contextlib.suppress(ValueError, RecursionError):
                row = json.loads(line.decode("utf-8")) if len(line) <= _LINE_MAX else None
            if not isinstance(row, dict):
                damaged.append(f"line {number} is truncated or corrupt")
                continue
            row = current_row(row)
            is_cycle = row.get("kind") == "cycle"
            if wrong := wrong_column(row, first or row) if is_cycle else wrong_note(row):
                damaged.append(f"line {number} is corrupt: {wrong}")
                continue
            first = first or (row if is_cycle else {})
            rows.append(row)
    return rows, _left_out("lines", damaged)


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines; of a line that is too long, only the first part."""
    while line := file.readline(_LINE_MAX + 1):
        end = line
        while len(end) > _LINE_MAX and not end.endswith(b"\n"):
            end = file.readline(_LINE_MAX + 1)
        yield line


def _left_out(item_name: str, damaged: Sequence[str]) -> list[str]:
    """Return the number of the left out and the first of them as a problem; none: no problem."""
    if not damaged:
        return []
    more = ", ..." if len(damaged) > _NAMED else ""
    return [f"{len(damaged)} {item_name} left out: {'; '.join(damaged[:_NAMED])}{more}"]


def _with_images(
    folder: Path, cycles: Sequence[dict[str, Any]]
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the cycles without a missing or damaged image, and the others as a problem.

    If no image is left, as without the folder of images, the log alone is kept.
    """
    kept: list[dict[str, Any]] = []
    damaged: list[str] = []
    for row in cycles:
        bad = next((name for name in row.get("images", ()) if not _is_image(folder / name)), None)
        if bad is None:
            kept.append(row)
        else:
            damaged.append(f"image {bad} is missing or damaged")
    if damaged and not any(row.get("images") for row in kept):
        missing = [f"{len(damaged)} cycles have no images: {damaged[0]}"]
        return [row | {"images": []} for row in cycles], missing
    return kept, _left_out("cycles", damaged)


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
    problems = _left_out(f"images of the reference {stage!r}", damaged)
    if any(own and not new for own, new in zip(row["images"], names, strict=True)):
        return None, problems
    return RecordedReference(
        folder, stage, names, row["image_time"], row["gauge_pressure"]
    ), problems


def _replaced(folder: Path, names: Sequence[str]) -> list[str]:
    """Return the names with the nearest sound image in place of each damaged one."""
    sound = [k for k, name in enumerate(names) if _is_image(folder / name)]
    if not sound:
        return []
    return [names[min(sound, key=lambda other: abs(other - k))] for k in range(len(names))]


def _is_image(path: Path) -> bool:
    """Return True if an image file exists and is complete."""
    try:
        status = path.stat()
        return _is_sound(path, status.st_mtime_ns, status.st_size)
    except (OSError, ValueError, InputError):
        return False


@lru_cache(maxsize=1 << 16)
def _is_sound(path: Path, modified_ns: int, size: int) -> bool:
    """Check a file once; a recording is loaded several times in a command."""
    return is_sound(read_file(path))


def _columns(cycles: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Convert rows to columns: numbers as float with null as NaN, all others as objects."""
    columns: dict[str, np.ndarray] = {}
    for key in cycles[0] if cycles else ("time", "phase", "images", "image_time"):
        values = [row.get(key) for row in cycles]
        try:
            columns[key] = np.array(values, dtype=float)  # None becomes NaN
        except (TypeError, ValueError):
            columns[key] = np.empty(len(values), dtype=object)
            columns[key][:] = values
    return columns
