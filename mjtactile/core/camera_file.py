"""Reader and writer of camera files: ROS, OpenCV, Kalibr, ini.

ROS: camera_info files and the output of `ros2 topic echo` and `rostopic echo`. OpenCV: YAML and
XML of `FileStorage`. A YAML file may have one additional field, a glass in front of the camera.
Files of other formats are refused; the message names the format and the conversion.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.camera_file_formats import number_list, read_table
from mjtactile.core.errors import InputError
from mjtactile.core.lens import MODELS, Lens, model_named, trimmed
from mjtactile.core.types import Array

# coefficient counts of OpenCV: plumb_bob without k3, with thin prism, with tilt
_COUNTS = tuple(sorted({0, 4, 12, 14} | {len(model.coefficients) for model in MODELS.values()}))
_GLASS = {
    "thickness_mm": (0.0, 1000.0, 1e-3),
    "refractive_index": (1.0, 3.0, 1.0),
    "distance_mm": (0.0, 1e5, 1e-3),
}
_NAMES = {
    "image_width": ("imagewidth", "width"),
    "image_height": ("imageheight", "height"),
    "camera_matrix": ("cameramatrix", "k", "intrinsicmatrix", "cameramat"),
    "distortion_coefficients": ("distortioncoefficients", "d", "distcoeffs", "distcoefs"),
}
"""Field of ROS to its names in other formats, in lower case without underscores."""


def read(path: Path) -> tuple[dict[str, Any], tuple[float, float, float] | None]:
    """Read a camera file.

    Args:
        path: The file.

    Returns:
        The fields of a `Pinhole`; if the file has a glass in front of the camera, also its
        thickness, m, refractive index, and distance, m.

    Raises:
        InputError: Names the file, the field and the valid choices; for a file of another format,
            the format and how to convert it.
    """
    table = read_table(path)
    source = str(path)
    glass = table.get("glass")
    return _pinhole(table, source), None if glass is None else _glass(glass, source)


def camera_info(size: tuple[int, int], K: Array, lens: Lens, name: str) -> dict[str, Any]:
    """Return the fields of a ROS camera_info file.

    Args:
        size: Width and height of the image, px.
        K: Intrinsic matrix (3, 3), px.
        lens: Lens model.
        name: Name of the camera.

    Returns:
        The fields, as `read` and ROS read them.
    """

    def matrix(value: Any, rows: int) -> dict[str, Any]:
        flat = np.ravel(value)
        return {"rows": rows, "cols": len(flat) // rows, "data": [float(x) for x in flat]}

    return {
        "image_width": size[0],
        "image_height": size[1],
        "camera_name": name,
        "camera_matrix": matrix(K, 3),
        "distortion_model": lens.model,
        "distortion_coefficients": matrix(lens.coefficients, 1),
        "rectification_matrix": matrix(np.eye(3), 3),
        "projection_matrix": matrix(np.column_stack([K, np.zeros(3)]), 3),
    }


def _pinhole(table: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the fields of a `Pinhole`."""
    keys = _keys(table, source)
    size = {}
    for name in ("image_width", "image_height"):
        value = table[keys[name]]
        value = int(value) if isinstance(value, float) and value.is_integer() else value
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise InputError(
                f"{value!r} is not a positive whole number", source=source, field=keys[name]
            )
        size[name.removeprefix("image_")] = value
    for name in ("binning_x", "binning_y"):
        if table.get(name) not in (None, 0, 1):
            raise InputError(
                "images with binning are not read: scale the camera matrix to the image",
                source=source,
                field=name,
                choices=[0, 1],
            )
    K = number_list(table, keys["camera_matrix"], (9,), source)
    fx, skew, cx, below, fy, cy, *last = K
    if fx <= 0 or fy <= 0 or skew or below or last != [0, 0, 1]:
        raise InputError(
            f"{K} is not [fx, 0, cx, 0, fy, cy, 0, 0, 1] with positive focal lengths",
            source=source,
            field=f"{keys['camera_matrix']}.data",
        )
    lens = _lens(table, keys["distortion_coefficients"], source)
    found = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": lens.coefficients}
    return {**size, **found, "distortion_model": lens.model}


def _keys(table: Mapping[str, Any], source: str) -> dict[str, str]:
    """Return the names that the fields of ROS have in this file."""
    plain = {str(key).lower().replace("_", "").replace(" ", ""): key for key in table}
    keys = {}
    for name, others in _NAMES.items():
        found = next((plain[other] for other in others if other in plain), None)
        if found is None:
            raise InputError("missing field", source=source, field=name, choices=_NAMES)
        keys[name] = found
    return keys


def _lens(table: Mapping[str, Any], key: str, source: str) -> Lens:
    """Return the lens; a file without the name of a model has one of OpenCV's."""
    k = [] if table[key] is None else number_list(table, key, _COUNTS, source)
    name = table.get("distortion_model")
    if name is None and table.get("fisheye_model") in (1, True):
        name = "equidistant"
    if name is None:
        name = "plumb_bob" if trimmed(k, 5) is not None else "rational_polynomial"
        if len(k) == 4 and any(k):
            raise InputError(
                "four coefficients are those of plumb_bob or of a fisheye: name the model",
                source=source,
                field="distortion_model",
                choices=("plumb_bob", "equidistant"),
            )
    model = model_named(name)
    if model is None:
        raise InputError(
            f"{name!r} is not supported", source=source, field="distortion_model", choices=MODELS
        )
    count = len(model.coefficients)
    coefficients = trimmed(k, count)
    if coefficients is None or not (model.tangential or len(k) in (0, count)):
        raise InputError(
            f"has {len(k)} coefficients, but {model.name} has {count}: calibrate without others "
            "(thin prism, tilt)",
            source=source,
            field=key,
            choices=[", ".join(model.coefficients)],
        )
    return Lens(model.name, coefficients)


def _glass(glass: Any, source: str) -> tuple[float, float, float]:
    """Return thickness, m, refractive index and distance, m, of a camera file's `glass`."""
    if not isinstance(glass, dict) or set(glass) != set(_GLASS):
        raise InputError(
            f"{glass!r} does not have exactly the fields of the glass",
            source=source,
            field="glass",
            choices=tuple(_GLASS),
        )
    values = []
    for name, (minimum, maximum, unit) in _GLASS.items():
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
