"""`Fidelity`: simulation accuracy, as the cheapest setting measured to meet a requirement.

    Fidelity.for_force_error(0.02)  the cheapest setting whose force error is at most 0.02 N
    Fidelity.for_real_time()        the most accurate one that runs at least as fast as the clock
    Fidelity.parse("0.02N")         the same by the argument of --accuracy: "0.02N" or "realtime"

The table, models/fidelity/measured.json, is written by `mjtactile bench accuracy`. It states the
machine and the versions of the measurement. Errors are those of the shipped sensors' membrane (see
docs/validation/accuracy.md). If a quasi-static membrane is valid, its settings are included too.
They are in models/fidelity/levels.json, written by `mjtactile bench meshless`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.core.fidelity_levels import MIN_FORCE_ERROR, read_accuracy

REAL_TIME_MARGIN = 1.25
"""Minimum speed of the physics relative to real time, with a margin for the other tasks."""
QUASISTATIC = "-mesh"
DEFAULT_FORCE_ERROR = 0.02
"""Default force error for the choice of effects, N."""


@dataclass(frozen=True)
class Fidelity:
    """A setting of the simulator with its measured performance."""

    mesh: tuple[int, int]  # vertices along x and y; the grid of a quasi-static membrane
    timestep: float  # upper limit, s; a rig takes the next shorter one for its camera's period
    tolerance: float  # of the solver
    force_error: float  # N, root mean square against the converged reference
    surface_error: float  # m, as `force_error`
    force_noise: float  # standard deviation while an object is held, N
    cost: float  # ms of one core per simulated second of two sensors holding an object
    met: bool = True  # False if no measured setting meets the requirement
    basis: str = ""  # reason of the choice
    asked: float = DEFAULT_FORCE_ERROR  # force error for the choice of effects, N
    effects: str = ""  # effects left out, in the format of `--effects`

    @property
    def real_time_factor(self) -> float:
        """Simulated over wall time of the physics alone."""
        return 1000.0 / self.cost

    @classmethod
    def for_force_error(
        cls, force_error: float, table: Path | None = None, *, membranes: bool = False
    ) -> Fidelity:
        """Return the cheapest measured setting with a force error of at most `force_error`, N.

        If there is none, return the most accurate setting, with `met` False. With `membranes`, the
        result may be a setting without a mesh. Raises InputError if `force_error` is not a number
        of at least `MIN_FORCE_ERROR`.
        """
        if not math.isfinite(force_error) or force_error < MIN_FORCE_ERROR:
            raise InputError(
                f"{force_error!r} N is not a finite force error of at least {MIN_FORCE_ERROR:g} N",
                source="Fidelity",
                field="force_error_N",
            )
        rows, stamp = load_table(table)
        rows = [*rows, *(load_membranes() if membranes else ())]
        good = [row for row in rows if row.force_error <= force_error]
        if good:
            best = min(good, key=lambda row: row.cost)
            reason = f"cheapest setting with at most {force_error:g} N of force error"
        else:
            best = min(rows, key=lambda row: row.force_error)
            reason = (
                f"no setting reaches {force_error:g} N; the closest has {best.force_error:.3g} N"
            )
        return replace(_with_basis(best, bool(good), reason, stamp), asked=force_error)

    @classmethod
    def for_real_time(cls, table: Path | None = None) -> Fidelity:
        """Return the most accurate setting in real time, or the fastest one, with `met` False."""
        rows, stamp = load_table(table)
        good = [row for row in rows if row.real_time_factor >= REAL_TIME_MARGIN]
        if good:
            reason = f"most accurate setting at {REAL_TIME_MARGIN:g} x real time or faster"
            return _with_basis(min(good, key=lambda row: row.force_error), True, reason, stamp)
        fastest = min(rows, key=lambda row: row.cost)
        reason = (
            "no setting is fast enough on that machine; the fastest runs at "
            f"{fastest.real_time_factor:.2f} x real time"
        )
        return _with_basis(fastest, False, reason, stamp)

    @classmethod
    def parse(cls, text: str, table: Path | None = None, *, membranes: bool = False) -> Fidelity:
        """Read "0.02N" or "realtime"; `membranes` as in `for_force_error`. Raises InputError."""
        value = read_accuracy(text, "--accuracy")
        if value is None:
            return cls.for_real_time(table)
        return cls.for_force_error(value, table, membranes=membranes)

    def with_effects(self, overrides: str) -> str:
        """Combine the user's `--effects` with the effects that this setting leaves out."""
        parts = [self.effects, "" if overrides == "auto" else overrides]
        return ",".join(part for part in parts if part) or "auto"

    def summary(self) -> dict[str, Any]:
        """Return the setting for the record of a run. JSON keys carry units."""
        return {
            "mesh": list(self.mesh),
            "timestep_ms": 1e3 * self.timestep,
            "tolerance": self.tolerance,
            "force_error_N": self.force_error,
            "surface_error_um": 1e6 * self.surface_error,
            "force_noise_N": self.force_noise,
            "ms_per_s": self.cost,
            "met": self.met,
            "basis": self.basis,
        }


def row_from_json(row: dict[str, Any]) -> Fidelity:
    """Invert `Fidelity.summary`, without `met` and `basis`."""
    return Fidelity(
        (int(row["mesh"][0]), int(row["mesh"][1])),
        1e-3 * row["timestep_ms"],
        row["tolerance"],
        row["force_error_N"],
        1e-6 * _nan_if_none(row["surface_error_um"]),
        _nan_if_none(row.get("force_noise_N")),
        row["ms_per_s"],
        effects=row.get("effects", ""),
    )


def _nan_if_none(value: float | None) -> float:
    return math.nan if value is None else value


def table_path() -> Path:
    return resources.folder("models/fidelity") / "measured.json"


def levels_path() -> Path:
    return resources.folder("models/fidelity") / "levels.json"


@cache
def load_membranes() -> Sequence[Fidelity]:
    """Return the measured settings of quasi-static membranes; empty without such a file."""
    path = levels_path()
    if not path.is_file():
        return ()
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
    return [row_from_json(row) for row in rows if row["effects"] == QUASISTATIC]


@cache
def load_table(path: Path | None = None) -> tuple[Sequence[Fidelity], str]:
    """Return the measured settings, and one line with machine, version and date."""
    path = table_path() if path is None else path
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        rows = tuple(row_from_json(row) for row in table["rows"])
        stamp = table["stamp"]
        text = f"{stamp['machine']}, MuJoCo {stamp['mujoco']}, {stamp['date']}"
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(
            f"not a table of measured settings: {type(error).__name__} {error}", source=path
        ) from error
    if not rows:
        raise InputError("has no rows", source=path, field="rows")
    return rows, text


def _with_basis(row: Fidelity, met: bool, reason: str, stamp: str) -> Fidelity:
    kind = "nodes of a quasi-static membrane," if row.effects else "vertices"
    text = (
        f"{reason}: {row.mesh[0]}x{row.mesh[1]} {kind} at {1e3 * row.timestep:.3g} ms, "
        f"measured {row.force_error:.3g} N, "
        f"{1e6 * row.surface_error:.0f} um, {row.real_time_factor:.2f} x real time ({stamp})"
    )
    return replace(row, met=met, basis=text)
