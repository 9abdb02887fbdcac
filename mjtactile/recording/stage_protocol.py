"""Indentation protocol of a recording: the indenter, its position, and its moves over time.

A protocol is a CSV file with one line per move. A person with a stage follows it. The simulated
stage does the same:

    time_s,depth_mm,shear_mm,speed_mm_s,force_N

`time_s` counts from the recording's first cycle. `depth_mm` is measured from first contact with the
inflated membrane. `shear_mm` is along x of the sensor (empty: 0). `speed_mm_s` is the speed of the
move (empty: 2). `force_N` is the force during the following hold (empty: unknown). It comes from a
load cell or a weight on the indenter. With a force alone, for example a weight, the depth is free.
With neither depth nor force there is no contact. The recording stores all of it as the note
`stage`.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mjtactile.core import foreign_file, resources
from mjtactile.core.errors import InputError

PROTOCOLS = "models/protocols"
LARGEST = 1 << 20  # maximum size of a protocol, bytes
COLUMNS: dict[str, tuple[str, float, float, float]] = {
    "time_s": ("time", 1.0, 0, 86400),
    "depth_mm": ("depth", 1e-3, -1, 500),
    "shear_mm": ("shear", 1e-3, -500, 500),
    "speed_mm_s": ("speed", 1e-3, 0.01, 1000),
    "force_N": ("force", 1.0, -1000, 1000),
}
"""Column to field, SI units in one unit of the file, lowest and highest value."""


INDENTER_FRACTIONS = {"press": 0.27, "drag": 0.27, "tap": 0.45, "still": 0.27}
"""Radius of the sphere of each shipped protocol, as a fraction of the frame's shorter side."""


def protocol_indenter(protocol: str | Path, side: float) -> str:
    """Return the indenter of a protocol for a frame.

    Args:
        protocol: Name of a shipped protocol, or a file, which gets the indenter of "press".
        side: Shorter side of the frame's opening, m.

    Returns:
        A sphere, such as "sphere:8", in steps of half a millimeter.
    """
    fraction = INDENTER_FRACTIONS.get(str(protocol), INDENTER_FRACTIONS["press"])
    return f"sphere:{max(math.floor(2e3 * fraction * side) / 2, 0.5):g}"


@dataclass(frozen=True)
class Move:
    """Move of the indenter, and the hold that follows.

    At `time`, s, it goes to `depth`, m, and `shear`, m, at `speed`, m/s, and stays. There the force
    is `force`, N. Unknown values are NaN. Without depth and force there is no contact.
    """

    time: float
    depth: float = math.nan
    shear: float = 0.0
    speed: float = 2e-3
    force: float = math.nan

    @property
    def touches(self) -> bool:
        return not (math.isnan(self.depth) and math.isnan(self.force))

    @property
    def is_weight(self) -> bool:
        """True if the force is known and the depth is not."""
        return math.isnan(self.depth) and not math.isnan(self.force)


@dataclass(frozen=True)
class Stage:
    """Indenter over the position `at` (x, y) m in S, and its moves in order.

    The format of the indenter ("sphere:8") is that of `mjtactile press`.
    """

    indenter: str
    at: tuple[float, float]
    moves: tuple[Move, ...]

    def note(self) -> dict[str, Any]:
        """Return the entry for a recording's notes; `stage_from_note` reads it."""
        rows = [
            {column: getattr(move, name) / scale for column, (name, scale, *_) in COLUMNS.items()}
            for move in self.moves
        ]
        return {"indenter": self.indenter, "at_mm": [1e3 * x for x in self.at], "moves": rows}

    def with_forces(self, forces: Sequence[float]) -> Stage:
        """Return a copy with the load cell's force during each hold, N."""
        return replace(
            self, moves=tuple(replace(m, force=f) for m, f in zip(self.moves, forces, strict=True))
        )


def read_moves(name_or_path: str | Path) -> tuple[Move, ...]:
    """Read the moves of a shipped protocol or a CSV file. Raises InputError that names file, line
    and column."""
    path = resources.find(name_or_path, PROTOCOLS, ".csv")
    try:
        lines = [
            line
            for line in foreign_file.read_text(path, LARGEST, "a protocol").splitlines()
            if line.strip() and line[0] != "#"
        ]
    except UnicodeDecodeError as error:
        raise InputError(f"cannot be read: {error}", source=path) from error
    return _moves(list(csv.DictReader(lines)), str(path))


def describe(move: Move) -> str:
    """Return the instruction of a move for a person at a stage."""
    if not move.touches:
        return f"{move.time:g} s: lift off"
    if move.is_weight:
        return f"{move.time:g} s: apply a weight of {move.force:g} N, indenter included"
    shear = f", {1e3 * move.shear:g} mm along x" if move.shear else ""
    return (
        f"{move.time:g} s: move to {1e3 * move.depth:g} mm below the first contact{shear}, at "
        f"{1e3 * move.speed:g} mm/s"
    )


def stage_from_note(note: Mapping[str, Any], source: object) -> Stage:
    """Create a stage from the result of `Stage.note` or from a user's table.

    Raises InputError that names the field.
    """
    try:
        indenter = str(note["indenter"])
        at = tuple(1e-3 * float(x) for x in note["at_mm"])
        rows = list(note["moves"])
        x, y = at
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"is not a stage: {error}",
            source=source,
            field="stage",
            choices=("indenter", "at_mm", "moves"),
        ) from error
    return Stage(indenter, (x, y), _moves(rows, str(source)))


def _moves(rows: Sequence[Mapping[str, Any]], source: str) -> tuple[Move, ...]:
    moves = tuple(_move(row, source, number) for number, row in enumerate(rows, 1))
    if not moves:
        raise InputError("has no moves", source=source, choices=COLUMNS)
    late = next((i for i in range(1, len(moves)) if moves[i].time <= moves[i - 1].time), None)
    if late is not None:
        raise InputError(
            "is not later than the previous move", source=source, field=f"move {late + 1}, time_s"
        )
    return moves


def _move(row: Mapping[str, Any], source: str, number: int) -> Move:
    unknown = [key for key in row if key not in COLUMNS]
    if unknown or "time_s" not in row:
        raise InputError(
            f"column {unknown[0]!r}" if unknown else "column time_s is missing",
            source=source,
            choices=COLUMNS,
        )
    values = {}
    for column, (name, scale, low, high) in COLUMNS.items():
        text = row.get(column)
        if text is None or str(text).strip() == "":
            continue
        try:
            value = float(text)
        except (TypeError, ValueError):
            value = math.nan
        if not low <= value <= high:
            message = f"{text!r} is not a number from {low:g} to {high:g}"
            raise InputError(message, source=source, field=f"move {number}, {column}")
        values[name] = value * scale
    if "time" not in values:
        raise InputError("is missing", source=source, field=f"move {number}, time_s")
    return Move(**values)
