"""Formats of camera files, read as tables: ROS, OpenCV, Kalibr, ini; others are refused.

Files come from other software, so that their size, depth and aliases are limited.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError

LARGEST = 1 << 17
"""Maximum size of a camera file, bytes."""
_LARGEST_BINARY = 1 << 24
"""The same of a file whose format is named in the message."""
DEEPEST = 16
"""Maximum depth of nested values in it."""
READABLE = ("ROS camera_info", "ros2 topic echo", "OpenCV YAML or XML", "Kalibr YAML", "ini of ROS")
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


def read_table(path: Path) -> dict[str, Any]:
    """Return the table in a camera file, with the fields of its format.

    Raises InputError; for a file of another format it names the format and how to convert it.
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
        return _kalibr_table(table, source)
    return table


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
    try:
        # OpenCV writes a directive that YAML does not have
        loader = Loader(re.sub(r"\A%YAML:.*\n", "", text))
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
    size = number_list(camera, "resolution", (2,), source)
    fx, fy, cx, cy = number_list(camera, "intrinsics", (4,), source)
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


def number_list(
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
