"""Log of a recording read back: whole lines, cycles with sound images, columns."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.image_decoding import decode, is_sound, read_file
from mjtactile.core.renamed import current_row
from mjtactile.core.types import Image
from mjtactile.recording.log_validation import has_its_checksum, wrong_column, wrong_note

_LINE_MAX = 1 << 24  # maximum length of a line, bytes
_NAMED = 3  # damaged lines or cycles in a message


def read_rows(log: Path) -> tuple[list[dict[str, Any]], list[str]]:
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
            wrong = wrong_column(row, first or row) if is_cycle else wrong_note(row)
            if wrong := wrong or _out_of_order(row, rows):
                damaged.append(f"line {number} is corrupt: {wrong}")
                continue
            first = first or (row if is_cycle else {})
            rows.append(row)
    return rows, left_out("lines", damaged)


def _out_of_order(row: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the reason if the line cannot follow the earlier ones; empty if it can."""
    if row.get("kind") == "start" and rows:
        return "it starts another recording"
    before = next((other for other in reversed(rows) if other.get("kind") == "cycle"), row)
    if row.get("kind") == "cycle" and row["time"] < before["time"]:
        return "its time is before that of an earlier cycle"
    return ""


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines; of a line that is too long, only the first part."""
    while line := file.readline(_LINE_MAX + 1):
        end = line
        while len(end) > _LINE_MAX and not end.endswith(b"\n"):
            end = file.readline(_LINE_MAX + 1)
        yield line


def left_out(item_name: str, damaged: Sequence[str]) -> list[str]:
    """Return the number of the left out and the first of them as a problem; none: no problem."""
    if not damaged:
        return []
    more = ", ..." if len(damaged) > _NAMED else ""
    return [f"{len(damaged)} {item_name} left out: {'; '.join(damaged[:_NAMED])}{more}"]


def without_damaged_files(header: Mapping[str, Any], problems: list[str]) -> dict[str, Any]:
    """Return the header without files whose text does not have its checksum; name them."""
    files = header.get("files", {})
    sound = {kind: file for kind, file in files.items() if has_its_checksum(file)}
    problems += [
        f"line 1: the text of the {k} file is corrupt and was ignored"
        for k in files
        if k not in sound
    ]
    return {**header, **({"files": sound} if files else {})}


def keep_force_limit(columns: dict[str, np.ndarray]) -> None:
    """Put the limit in force where version 1 has 0, which meant "as before"; NaN before any."""
    limits = columns.get("command_force_limit")
    if limits is None:
        return
    limit = math.nan
    for k, value in enumerate(limits):
        limit = value if value > 0 else limit
        limits[k] = limit


def with_images(
    folder: Path, cycles: Sequence[dict[str, Any]]
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the cycles without a missing or damaged image, and the others as a problem.

    If no image is left, as without the folder of images, the log alone is kept.
    """
    kept: list[dict[str, Any]] = []
    damaged: list[str] = []
    for row in cycles:
        bad = next((name for name in row.get("images", ()) if not is_image(folder / name)), None)
        if bad is None:
            kept.append(row)
        else:
            damaged.append(f"image {bad} is missing or damaged")
    if damaged and not any(row.get("images") for row in kept):
        missing = [f"{len(damaged)} cycles have no images: {damaged[0]}"]
        return [row | {"images": []} for row in cycles], missing
    return kept, left_out("cycles", damaged)


def read_image(path: Path, time: float) -> Image:
    pixels = decode(read_file(path), cv2.IMREAD_GRAYSCALE) if is_image(path) else None
    if pixels is None:
        raise InputError("missing or broken image", source=path)
    return Image(pixels.astype(np.uint8), time)


def is_image(path: Path) -> bool:
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


def columns_of(cycles: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
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
