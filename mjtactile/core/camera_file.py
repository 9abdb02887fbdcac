"""Reader of ROS camera_info files with one additional field: a glass in front of the camera."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from mjtactile.core.errors import InputError

_PANE = {
    "thickness_mm": (0.0, 1000.0, 1e-3),
    "refractive_index": (1.0, 3.0, 1.0),
    "distance_mm": (0.0, 1e5, 1e-3),
}
_YAML_FIELDS = (
    "image_width",
    "image_height",
    "camera_matrix",
    "distortion_model",
    "distortion_coefficients",
)


def read(path: Path) -> tuple[dict[str, Any], tuple[float, float, float] | None]:
    """Read a ROS camera_info file.

    Args:
        path: The file.

    Returns:
        The fields of a `Pinhole`; if the file has a glass in front of the camera, also its
        thickness, m, refractive index, and distance, m.

    Raises:
        InputError: Names the file, the field and the valid choices.
    """
    table = _read_yaml(path)
    source = str(path)
    for name in _YAML_FIELDS:
        if name not in table:
            raise InputError("missing field", source=source, field=name, choices=_YAML_FIELDS)
    size = {}
    for name in ("image_width", "image_height"):
        if isinstance(table[name], bool) or not isinstance(table[name], int) or table[name] < 1:
            raise InputError(
                f"{table[name]!r} is not a positive whole number", source=source, field=name
            )
        size[name.removeprefix("image_")] = table[name]
    if table["distortion_model"] != "plumb_bob":
        raise InputError(
            f"{table['distortion_model']!r} is not supported",
            source=source,
            field="distortion_model",
            choices=["plumb_bob"],
        )
    K = _numbers(table["camera_matrix"], "camera_matrix", (9,), source)
    fx, skew, cx, below, fy, cy, *last = K
    if fx <= 0 or fy <= 0 or skew or below or last != [0, 0, 1]:
        raise InputError(
            f"{K} is not [fx, 0, cx, 0, fy, cy, 0, 0, 1] with positive focal lengths",
            source=source,
            field="camera_matrix.data",
        )
    k = _numbers(table["distortion_coefficients"], "distortion_coefficients", (4, 5), source)
    lens = {**size, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": tuple((*k, 0.0)[:5])}
    glass = table.get("glass")
    return lens, None if glass is None else _pane(glass, source)


def _read_yaml(path: Path) -> dict[str, Any]:
    import yaml  # only this function needs it

    try:
        table = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror}", source=path, field="camera"
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"not valid YAML: {text}", source=path) from error
    if not isinstance(table, dict):
        raise InputError("is not a ROS camera_info file", source=path, choices=_YAML_FIELDS)
    return table


def _pane(glass: Any, source: str) -> tuple[float, float, float]:
    """Thickness m, refractive index and distance m of a camera file's `glass`."""
    if not isinstance(glass, dict) or set(glass) != set(_PANE):
        raise InputError(
            f"{glass!r} does not have exactly the fields of the glass",
            source=source,
            field="glass",
            choices=tuple(_PANE),
        )
    values = []
    for name, (minimum, maximum, unit) in _PANE.items():
        value = glass[name]
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not minimum <= value <= maximum
        ):
            raise InputError(
                f"{value!r} is not a number from {minimum:g} to {maximum:g}",
                source=source,
                field=f"glass.{name}",
            )
        values.append(value * unit)
    return values[0], values[1], values[2]


def _numbers(value: Any, name: str, lengths: tuple[int, ...], source: str) -> list[float]:
    """The `data` of a ROS matrix (or a bare list) as finite floats."""
    data = value.get("data") if isinstance(value, dict) else value
    count = " or ".join(map(str, lengths))
    if not isinstance(data, list) or len(data) not in lengths:
        raise InputError(
            f"{data!r} is not a list of {count} numbers", source=source, field=f"{name}.data"
        )
    numbers = []
    for i, x in enumerate(data):
        try:  # YAML 1.1 reads 1e-5 (no point) as text
            number = float("nan") if isinstance(x, bool) else float(x)
        except (TypeError, ValueError):
            number = float("nan")
        if not math.isfinite(number):
            raise InputError(
                f"{x!r} is not a finite number", source=source, field=f"{name}.data[{i}]"
            )
        numbers.append(number)
    return numbers
