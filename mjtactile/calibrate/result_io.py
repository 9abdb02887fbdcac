"""Result files of all calibrations: common metadata, and the location of refused results."""

from __future__ import annotations

import csv
import datetime
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import calibration_parts, foreign_file
from mjtactile.core.calibration_parts import CalibrationMetadata
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.recording.files import to_json, versions, write_json, write_text

_LARGEST = 1 << 25  # maximum size of a table, bytes


def stamp_of(design: SensorDesign, residuals: Mapping[str, Any]) -> CalibrationMetadata:
    """Return the metadata of a calibration part that was measured now."""
    return calibration_parts.stamp(design, versions(), to_json(residuals))


def stamp(kind: str, reasons: Sequence[str]) -> dict[str, Any]:
    """Return kind, verdict ("good" or "refused"), reasons of a refusal, date and versions."""
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    return {
        "calibration": kind,
        "verdict": "refused" if reasons else "good",
        "reasons": list(reasons),
        "date": now,
        "versions": versions(),
    }


def write(
    path: Path, result: Mapping[str, Any], writer: Callable[[Path, Any], None] = write_json
) -> Path:
    """Write a result to `path`; a refused one to NAME.refused.SUFFIX in the same folder.

    A good file is thus never replaced by a refused one.
    """
    if result["verdict"] == "refused":
        path = path.with_name(f"{path.stem}.refused{path.suffix}")
    try:
        writer(path, result)
    except OSError as error:
        raise InputError(
            f"the file cannot be written: {error.strerror}", source=path, field="--out"
        ) from error
    return path


def write_yaml(path: Path, value: Mapping[str, Any]) -> None:
    """Write `value` as YAML atomically."""
    import yaml  # only this function needs it

    write_text(path, yaml.safe_dump(to_json(value), sort_keys=False, default_flow_style=None))


def read_columns(
    path: Path, numeric: Sequence[str], texts: Sequence[str] = (), *, fewest: int = 1
) -> dict[str, Any]:
    """Read the columns of a CSV file with a header line.

    Columns are arrays of finite numbers, or lists of texts. Other columns are ignored. Raises
    InputError naming file, line and column.
    """
    try:
        text = foreign_file.read_text(path, _LARGEST, "a table")
        lines = io.StringIO(text, newline="")
        rows = list(
            csv.DictReader(row for row in lines if row.strip() and not row.lstrip().startswith("#"))
        )
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"no CSV file: {error}", source=path) from error
    names = list(rows[0]) if rows else []
    missing = [name for name in (*numeric, *texts) if name not in names]
    if missing:
        raise InputError(
            "missing column", source=path, field=missing[0], choices=(*numeric, *texts)
        )
    if len(rows) < fewest:
        raise InputError(
            f"the file has {len(rows)} rows; at least {fewest} are needed", source=path
        )
    result: dict[str, Any] = {name: _numbers(path, name, rows) for name in numeric}
    return result | {name: [(row[name] or "").strip() for row in rows] for name in texts}


def _numbers(path: Path, name: str, rows: Sequence[Mapping[str, str | None]]) -> Array:
    values = []
    for line, row in enumerate(rows, 2):
        try:
            value = float(row[name] or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            message = f"{row[name]!r} is not a finite number"
            raise InputError(message, source=path, field=f"line {line}, column {name}")
        values.append(value)
    return np.array(values)


def fit_line(x: Array, y: Array) -> tuple[Array, Array, float]:
    """Fit y = a + b x by least squares.

    Returns:
        (a, b), their standard deviations, and the rms residual.
    """
    A = np.column_stack([np.ones_like(x), x])
    inverse = np.linalg.inv(A.T @ A)
    coefficients = inverse @ A.T @ y
    left = y - A @ coefficients
    variance = float(left @ left) / max(len(x) - 2, 1)
    return coefficients, np.sqrt(variance * np.diag(inverse)), float(np.sqrt(np.mean(left**2)))
