"""A recording of a run: written while it happens, readable however it ended. The format: docs/recording.md.

A recording is a folder with `log.jsonl` (one JSON object a line) and `frames/*.png` (every camera image, lossless).
A background thread writes the images of a cycle first and its line last, so what the log names is on disk.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import platform
import queue
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from mjtactile import resources
from mjtactile.errors import DeviceError, InputError
from mjtactile.types import Array, Command, GripperState, Image, Touch, ValveState

FORMAT, VERSION = "mjtactile-recording", 1
FINGERS = ("left", "right")
# Huffman coding alone, unfiltered: as small as the slow settings on images with sensor noise, three times as fast.
_PNG = [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY, cv2.IMWRITE_PNG_COMPRESSION, 1,
        cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
_QUEUE_CYCLES = 16  # the loop waits when the disk is this far behind: nothing is dropped


class CycleLike(Protocol):
    """What one control cycle offers to be recorded; `mjtactile.control.Cycle` is one."""

    @property
    def time(self) -> float: ...
    @property
    def images(self) -> tuple[Image, ...]: ...
    @property
    def touch(self) -> tuple[Touch, ...]: ...
    @property
    def gripper(self) -> GripperState: ...
    @property
    def valves(self) -> tuple[ValveState, ...]: ...
    @property
    def sent(self) -> Command: ...
    @property
    def perception_ms(self) -> float: ...


def to_json(value: Any) -> Any:
    """Make `value` valid JSON: non-finite numbers become null, numpy values plain ones, paths text."""
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [to_json(item) for item in value]
    if isinstance(value, np.generic):
        return to_json(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return str(value)


def write_json(path: Path, value: Any) -> None:
    """Write `value` to `path` at once or not at all: a reader never sees half a file."""
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(to_json(value), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(path)


def versions() -> dict[str, str]:
    """Versions of what takes part in a measurement."""
    return {"mjtactile": importlib.metadata.version("mjtactile"), "opencv": cv2.__version__, "numpy": np.__version__,
            "python": platform.python_version()}


def provenance(header: Mapping[str, Any]) -> dict[str, Any]:
    """Versions, and the text of the sensor and rig files that a header names: with what was recorded can be looked up when
    those files have long changed."""
    files = {}
    for key, folder in (("sensor", "models/sensors"), ("rig", "models/rigs")):
        name = header.get(key)
        try:
            text = resources.find(name, folder, ".toml").read_text(encoding="utf-8") if name else None
        except (InputError, OSError):  # a rig without a file: sim, replay
            text = None
        if text is not None:
            files[key] = {"name": str(name), "sha256": hashlib.sha256(text.encode()).hexdigest(), "text": text}
    return {"versions": versions(), "files": files}


def _row(cycle: CycleLike, names: Sequence[str], truth: Mapping[str, Any]) -> dict[str, Any]:
    """One line of the log; the keys are those of docs/recording.md."""
    touch, gripper, sent = cycle.touch, cycle.gripper, cycle.sent
    return {
        "kind": "cycle", "time": cycle.time, "phase": sent.phase,
        "images": list(names), "image_time": [image.time for image in cycle.images],
        "force_normal": [t.force_normal for t in touch], "force_normal_sd": [t.force_normal_sd for t in touch],
        "touching": [t.touching for t in touch], "status": [t.status for t in touch],
        "marker_count": [0 if t.markers is None else len(t.markers) for t in touch],
        "opening": gripper.opening, "speed": gripper.speed, "effort": gripper.effort, "lift_height": gripper.lift_height,
        "gripper_time": gripper.time, "gripper_age": gripper.age,
        "valve_open": [valve.is_open for valve in cycle.valves],
        "pressure_gauge": [valve.pressure_gauge for valve in cycle.valves],
        "valve_time": [valve.time for valve in cycle.valves], "valve_age": [valve.age for valve in cycle.valves],
        "command_opening": sent.opening, "command_force_limit": sent.force_limit, "command_lift_height": sent.lift_height,
        "memory": dict(sent.memory), "perception_ms": cycle.perception_ms,
        "state": getattr(cycle, "state", "running"), "reason": getattr(cycle, "reason", ""), **truth,
    }  # fmt: skip


class Recorder:
    """Writes a recording into `folder` (made if needed; an older recording there is replaced).

    `header` says what ran (object, sensor, controller, rig, seed). `add` never waits for the disk unless it is 16 cycles
    behind. Use as a context manager, or call `close` on every exit path; both may be done after an exception.
    """

    def __init__(self, folder: str | Path, header: Mapping[str, Any], *, frames: bool = True):
        self.folder = Path(folder)
        self.snapshot: CycleLike | None = None
        """The cycle to show: the latest of the hold phase, before that the one with the greatest force."""
        self.cycles = 0
        self._frames, self._error, self._closed = frames, None, False
        (self.folder / "frames").mkdir(parents=True, exist_ok=True)
        for old in (self.folder / "frames").glob("*.png"):
            old.unlink()
        self._log = (self.folder / "log.jsonl").open("w", encoding="utf-8")
        self._queue: queue.Queue[tuple[Mapping[str, Any], list[tuple[str, Image]]] | None] = queue.Queue(_QUEUE_CYCLES)
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()
        self._put({"kind": "start", "format": FORMAT, "version": VERSION, **provenance(header), **header})

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, cycle: CycleLike, **truth: Any) -> None:
        """Record one cycle; `truth` are ground-truth columns (`force_normal_true`, …) that a scorer knows."""
        if self.cycles == 0 and (last := getattr(cycle, "last", None)) is not None:
            self.note(start_opening=last.opening, start_lift_height=last.lift_height)
        images = [(f"frames/{self.cycles:06d}_{finger}.png", image)
                  for finger, image in zip(FINGERS, cycle.images, strict=False)] if self._frames else []
        self._put(_row(cycle, [name for name, _ in images], truth), images)
        self.cycles += 1
        if self.snapshot is None or _worth_showing(cycle) >= _worth_showing(self.snapshot):
            self.snapshot = cycle

    def add_reference(self, stage: str, images: Sequence[Sequence[Image]], pressure_gauge: Sequence[float | None]) -> None:
        """Record the images of a reference ("flat", "rest"), one list a finger, and the pressures it was taken at, Pa."""
        named = [[(f"frames/{stage}_{i:02d}_{finger}.png", image) for i, image in enumerate(shots)]
                 for finger, shots in zip(FINGERS, images, strict=False)] if self._frames else []
        self._put({"kind": "reference", "stage": stage, "images": [[name for name, _ in shots] for shots in named],
                   "image_time": [[image.time for image in shots] for shots in images],
                   "pressure_gauge": list(pressure_gauge)}, [pair for shots in named for pair in shots])

    def note(self, **values: Any) -> None:
        """Record facts that are no cycle, such as `break_force_N`."""
        self._put({"kind": "note", **values})

    def close(self, **outcome: Any) -> None:
        """Write what is queued and an `end` line with `outcome`; later calls do nothing."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(({"kind": "end", **outcome}, []))
        self._queue.put(None)
        self._thread.join()
        self._log.close()
        self._raise()

    def discard(self) -> None:
        """Close and remove the recording: for a run that never began."""
        self.close()
        for path in (*(self.folder / "frames").glob("*.png"), self.folder / "log.jsonl"):
            path.unlink()
        (self.folder / "frames").rmdir()
        self.folder.rmdir()

    def _put(self, line: Mapping[str, Any], images: Sequence[tuple[str, Image]] = ()) -> None:
        self._raise()
        self._queue.put((line, list(images)))

    def _raise(self) -> None:
        if self._error is not None:
            raise DeviceError(f"{self.folder}: the recording cannot be written: {self._error}")

    def _work(self) -> None:
        """The background thread: images first, then the line that names them."""
        while (item := self._queue.get()) is not None:
            if self._error is not None:
                continue  # keep emptying the queue so that the loop does not hang on it
            try:
                line, images = item
                for name, image in images:
                    (self.folder / name).write_bytes(cv2.imencode(".png", image.pixels, _PNG)[1].tobytes())
                self._log.write(json.dumps(to_json(line), allow_nan=False) + "\n")
                self._log.flush()
            except (OSError, ValueError, cv2.error) as error:
                self._error = error


def _worth_showing(cycle: CycleLike) -> tuple[bool, float]:
    if cycle.sent.phase == "hold":
        return True, 0.0
    forces = [t.force_normal for t in cycle.touch if math.isfinite(t.force_normal)]
    return False, sum(forces) if forces else -math.inf


@dataclass(frozen=True, eq=False)
class RecordedReference:
    """The images that a reference was taken from, and the chambers' gauge pressures, Pa (None: not measured)."""

    folder: Path
    stage: str
    names: Sequence[Sequence[str]]
    times: Sequence[Sequence[float]]
    pressure_gauge: Sequence[float | None]

    def images(self, finger: int) -> Iterator[Image]:
        """The images of one finger. Raises InputError naming a file that is missing or broken."""
        for name, time in zip(self.names[finger], self.times[finger], strict=True):
            yield _read_image(self.folder / name, time)


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording read back. `columns[key]` has one row a cycle; a JSON null is NaN. `complete`: it was closed properly."""

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
        return len(self.columns["images"][0]) if len(self) else 0

    @property
    def valve_count(self) -> int:
        return len(self.columns["valve_open"][0]) if len(self) else 0

    def __len__(self) -> int:
        return len(self.columns["time"])

    def column(self, key: str, width: int = 2) -> Array:
        """A numeric column (cycles, width); all NaN when the recording has none, as for the truth of a real run."""
        if key not in self.columns:
            return np.full((len(self), width), np.nan)
        return self.columns[key].astype(float).reshape(len(self), -1)

    def phases(self) -> list[tuple[str, float, float]]:
        """The phases in order: name, start and end time in s."""
        names, times = self.columns["phase"], self.columns["time"]
        starts = [i for i in range(len(self)) if i == 0 or names[i] != names[i - 1]]
        ends = [*starts[1:], len(self) - 1]
        return [(str(names[a]), float(times[a]), float(times[b])) for a, b in zip(starts, ends, strict=True)]

    def images(self) -> Iterator[tuple[Image, ...]]:
        """The camera images cycle by cycle. Raises InputError naming a file that is missing or broken."""
        for names, times in zip(self.columns["images"], self.columns["image_time"], strict=True):
            yield tuple(_read_image(self.folder / n, t) for n, t in zip(names, times, strict=False))


def _read_image(path: Path, time: float) -> Image:
    pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if pixels is None:
        raise InputError("missing or broken image", source=path)
    return Image(pixels.astype(np.uint8), time)


def load_recording(path: str | Path) -> Recording:
    """Read the recording in `path` (the folder itself, or a run's folder around it).

    A run that was cut off gives what was written until then: a last line cut in half is left out and named in
    `problems`. Raises InputError when there is no recording or it is of another version.
    """
    folder = Path(path)
    folder = folder / "recording" if (folder / "recording").is_dir() else folder
    log = folder / "log.jsonl"
    if not log.is_file():
        raise InputError("no recording here: there is no log.jsonl", source=folder)
    rows, problems = _parse(log)
    header = rows[0] if rows else {}
    if header.get("format") != FORMAT or header.get("version") != VERSION:
        found = f"{header.get('format')} version {header.get('version')}"
        raise InputError(f"{found}, expected {FORMAT} version {VERSION}", source=log, field="line 1")
    notes: dict[str, Any] = {}
    for row in rows:
        if row.get("kind") in ("note", "end"):
            notes |= {key: value for key, value in row.items() if key != "kind"}
    cycles = [row for row in rows if row.get("kind") == "cycle"]
    complete = rows[-1].get("kind") == "end"
    if not complete:
        problems.append(f"cut off after {len(cycles)} cycles")
    references = tuple(RecordedReference(folder, row["stage"], row["images"], row["image_time"], row["pressure_gauge"])
                       for row in rows if row.get("kind") == "reference")
    return Recording(folder, header, notes, _columns(cycles), complete, tuple(problems), references)


def _parse(log: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Every line that is whole; the first that is not ends the log."""
    rows: list[dict[str, Any]] = []
    with log.open("rb") as lines:
        for number, line in enumerate(lines, 1):
            try:
                row = json.loads(line.decode("utf-8"))
            except ValueError:
                return rows, [f"line {number} is cut off or broken; it and what follows was left out"]
            rows.append(row if isinstance(row, dict) else {})
    return rows, []


def _columns(cycles: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Rows to columns: numbers as float with null as NaN, all else as objects."""
    columns: dict[str, np.ndarray] = {}
    for key in cycles[0] if cycles else ("time", "phase", "images", "image_time"):
        values = [row.get(key) for row in cycles]
        try:
            columns[key] = np.array(values, dtype=float)  # None becomes NaN
        except (TypeError, ValueError):
            columns[key] = np.empty(len(values), dtype=object)
            columns[key][:] = values
    return columns
