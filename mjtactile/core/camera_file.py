"""Reader and writer of camera files: ROS, OpenCV, Kalibr, ini.

ROS: camera_info files and the output of `ros2 topic echo` and `rostopic echo`. OpenCV: YAML and
XML of `FileStorage`. A YAML file may have one additional field, a glass in front of the camera.
Files of other formats are refused; the message names the format and the conversion. Files come from
other software, so that their size, depth and aliases are limited.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.lens import MODELS, Lens, model_named, trimmed
from mjtactile.core.types import Array

LARGEST = 1 << 17
"""Maximum size of a camera file, bytes."""
_LARGEST_BINARY = 1 << 24
"""The same of a file whose format is named in the message."""
DEEPEST = 16
"""Maximum depth of nested values in it."""
READABLE = ("ROS camera_info", "ros2 topic echo", "OpenCV YAML or XML", "Kalibr YAML", "ini of ROS")
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
_CAMERA_INFO = "write its values as a ROS camera_info file (docs/reference/conventions.md)"
_BINARY = {
    b"MATLAB": (
        "a MAT-file of MATLAB",
        "convert it by cameraIntrinsicsToOpenCV and " + _CAMERA_INFO,
    ),
    b"\x1f\x8b": ("a compressed archive", "unpack it and give its ost.yaml"),
    b"PK": ("an archive of numpy or zip", "unpack it and " + _CAMERA_INFO),
    b"\x93NUMPY": ("an array of numpy", _CAMERA_INFO),
}
"""First bytes of a file to its format and the conversion."""
_FOREIGN = {
    r"^[ \t]*\d+ [A-Z_]{,20}(PINHOLE|RADIAL|OPENCV|FISHEYE)[A-Z_]* \d+ \d+ ": (
        "a cameras.txt of COLMAP",
        "the parameters of OPENCV are fx, fy, cx, cy, k1, k2, p1, p2; " + _CAMERA_INFO,
    ),
    r"^Camera1?\.fx *:": ("a settings file of ORB-SLAM", _CAMERA_INFO),
    r"^model_type *:": (
        "a camera file of camodocal (VINS)",
        "k2 to k5, mu, mv, u0, v0 of KANNALA_BRANDT are k1 to k4, fx, fy, cx, cy of equidistant; "
        + _CAMERA_INFO,
    ),
    r'^[ \t]*"value0" *:': ("a calibration of Basalt", _CAMERA_INFO),
    r"<calibration>": (
        "a calibration of Metashape",
        "export it as OpenCV camera calibration (*.xml)",
    ),
}
"""Pattern in a text file to its format and the conversion."""


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
    text = _text(path)
    source = str(path)
    for pattern, (name, conversion) in _FOREIGN.items():
        if re.search(pattern, text, re.M):
            raise _foreign(source, name, conversion)
    if text.lstrip().startswith("<"):
        table = _xml_table(text, source)
    elif re.search(r"^\[image\][ \t\r]*$", text, re.M):
        table = _ini_table(text, source)
    else:
        table = _yaml_table(text, source)
    if any(re.fullmatch(r"cam\d+", str(key)) for key in table):
        table = _kalibr_table(table, source)
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


# -- formats


def _text(path: Path) -> str:
    data = foreign_file.read_bytes(path, _LARGEST_BINARY, "a camera file", "camera")
    for start, (name, conversion) in _BINARY.items():
        if data.startswith(start):
            raise _foreign(path, name, conversion)
    if len(data) > LARGEST:
        raise InputError(
            f"is larger than {LARGEST >> 10} KiB, the limit for a camera file", source=path
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"is not a text file: {error}", source=path, choices=READABLE) from error


def _foreign(source: Any, name: str, conversion: str) -> InputError:
    return InputError(f"is {name}, which is not read: {conversion}", source=source)


def _yaml_table(text: str, source: str) -> dict[str, Any]:
    """Return the first document of a YAML file. Matrices of OpenCV are tables."""
    import yaml  # only this function needs it

    class Loader(yaml.SafeLoader):
        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ValueError("aliases (*) are not read")
            self.depth += 1
            if self.depth > DEEPEST:
                raise ValueError(f"values are nested more than {DEEPEST} deep")
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", Loader.construct_yaml_map)
    # OpenCV writes a directive that YAML does not have
    loader = Loader(re.sub(r"\A%YAML:.*\n", "", text))
    try:
        table = loader.get_data() if loader.check_data() else None
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        message = " ".join(str(error).split())
        raise InputError(f"not valid YAML: {message}", source=source) from error
    if not isinstance(table, dict):
        raise InputError("is not a camera file", source=source, choices=READABLE)
    return table


def _xml_table(text: str, source: str) -> dict[str, Any]:
    """Return the entries of an XML file of OpenCV; matrices become lists."""
    from xml.etree import ElementTree  # only this function needs it

    if re.search(r"<!(?!--)", text):
        raise InputError("not valid XML of OpenCV: declarations are not read", source=source)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"not valid XML: {error}", source=source) from error
    if root.tag != "opencv_storage":
        raise InputError(
            f"is not a camera file: <{root.tag}>", source=source, choices=["<opencv_storage>"]
        )
    table: dict[str, Any] = {}
    for child in root:
        data = child.find("data")
        words = ((child if data is None else data).text or "").split()
        values = [_number(word) for word in words]
        table[child.tag] = values if data is not None or len(words) != 1 else values[0]
    return table


def _ini_table(text: str, source: str) -> dict[str, Any]:
    """Return the entries of an ini file of ROS: a title in a line, and lines of numbers."""
    table: dict[str, Any] = {}
    title = ""
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if not words or words[0].startswith("["):
            continue
        if words[0][0].isalpha():
            title = "_".join(words)
            table[title] = []
        elif title:
            table[title] += [_number(word) for word in words]
    for name in ("width", "height"):
        if len(table.get(name, ())) == 1:
            table[name] = table[name][0]
    if "distortion" in table:
        table["distortion_coefficients"] = table.pop("distortion")
    return table


def _kalibr_table(table: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the only camera of a Kalibr file in the fields of ROS."""
    cameras = [key for key in table if re.fullmatch(r"cam\d+", str(key))]
    if len(cameras) > 1:
        raise InputError(
            f"has {len(cameras)} cameras: keep the section of one", source=source, choices=cameras
        )
    name = cameras[0]
    camera = table[name]
    if not isinstance(camera, dict):
        raise InputError("is not a section", source=source, field=name)
    if camera.get("camera_model") != "pinhole":
        raise InputError(
            f"{camera.get('camera_model')!r} of Kalibr is not read: calibrate again with "
            "--models pinhole-radtan or pinhole-equi",
            source=source,
            field=f"{name}.camera_model",
            choices=["pinhole"],
        )
    found = {key: camera[key] for key in ("distortion_model",) if key in camera}
    size = _list(camera, "resolution", (2,), source)
    fx, fy, cx, cy = _list(camera, "intrinsics", (4,), source)
    found |= {"image_width": size[0], "image_height": size[1]}
    found["camera_matrix"] = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    found["distortion_coefficients"] = camera.get("distortion_coeffs")
    return found | ({"glass": table["glass"]} if "glass" in table else {})


def _number(word: str) -> Any:
    """Return a word as an integer or a float; unchanged if it is neither."""
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


# -- fields


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
    K = _list(table, keys["camera_matrix"], (9,), source)
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
    k = [] if table[key] is None else _list(table, key, _COUNTS, source)
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


def _list(
    table: Mapping[str, Any], name: str, lengths: tuple[int, ...], source: str
) -> list[float]:
    """Return the `data` of a matrix (or a bare list) as finite floats."""
    value = table.get(name)
    data = value.get("data") if isinstance(value, dict) else value
    if isinstance(data, list) and any(isinstance(row, list) for row in data):
        data = [x for row in data for x in (row if isinstance(row, list) else [row])]
    count = " or ".join(map(str, lengths))
    if not isinstance(data, list) or len(data) not in lengths:
        raise InputError(
            f"{_short(data)} is not a list of {count} numbers", source=source, field=f"{name}.data"
        )
    values = []
    for i, x in enumerate(data):
        try:  # YAML 1.1 reads 1e-5 (no point) as text
            converted = float("nan") if isinstance(x, bool) else float(x)
        except (TypeError, ValueError, OverflowError):
            converted = float("nan")
        if not math.isfinite(converted):
            raise InputError(
                f"{_short(x)} is not a finite number", source=source, field=f"{name}.data[{i}]"
            )
        values.append(converted)
    return values


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:80]}..."
