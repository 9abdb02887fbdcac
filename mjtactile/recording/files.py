"""Files of a run: valid JSON, written atomically, and the header of a recording.

A recording is a folder with `log.jsonl` (one JSON object per line) and `frames/*.png` (camera
images, lossless). For the format see docs/reference/recording_format.md.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flag
from mjtactile.core.types import FINGERS

FORMAT = "mjtactile-recording"
VERSION = 2
"""Format version of written files. Since version 2, a force limit of 0 means 0 N, and null an
unknown one."""
READABLE = (1, 2)
LOG = "log.jsonl"
FRAMES = "frames"
RECORDINGS = "recordings"
"""In the folder of an evaluation: a recording an episode."""


def finger_names(count: int) -> tuple[str, ...]:
    """Return the default names of the fingers in files: left, right, finger3, …"""
    return (*FINGERS, *(f"finger{number}" for number in range(3, count + 1)))[:count]


def to_json(value: Any) -> Any:
    """Make `value` valid JSON: non-finite numbers become null, numpy values plain ones, paths
    text."""
    if isinstance(value, Flag):
        return to_json(value.to_dict())
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
    """Write `value` to `path` atomically."""
    write_text(path, json.dumps(to_json(value), indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` atomically: a reader never reads a partial file."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def versions() -> dict[str, str]:
    """Return the versions of the software used in a measurement."""
    return {
        "mjtactile": importlib.metadata.version("mjtactile"),
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def provenance(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return the versions, and the contents of the files that a header names.

    These are the sensor, sensors of single fingers ("sensor_left"), rig and controller. Contents
    that the header has already are kept. They document the recording conditions after the files
    have changed.
    """
    scenario = header.get("scenario") or {}
    named = {
        "sensor": (header.get("sensor") or scenario.get("sensor"), *SENSORS),
        **{f"sensor_{key}": (name, *SENSORS) for key, name in scenario.get("sensors", {}).items()},
        "rig": (header.get("rig"), "models/rigs", ".toml"),
        "controller": (header.get("controller"), "controllers", ".py"),
    }
    found = {key: stored_file(*where) for key, where in named.items()}
    files = {key: file for key, file in found.items() if file is not None}
    return {"versions": versions(), "files": files | dict(header.get("files", {}))}


SENSORS = ("models/sensors", ".toml")
"""Folder of shipped sensors, and suffix of sensor files."""


def stored_file(name: Any, folder: str, suffix: str) -> dict[str, str] | None:
    """Return name, SHA-256 and text of the file that a user's `name` stands for; None without a
    file, as of the rigs "sim" and "replay:FOLDER"."""
    try:
        text = resources.find(name, folder, suffix).read_text(encoding="utf-8-sig") if name else ""
    except (InputError, OSError, ValueError):
        return None
    if not name:
        return None
    checksum = hashlib.sha256(text.encode()).hexdigest()
    return {"name": str(name), "sha256": checksum, "text": text}
