"""Sensors of a recording, from the texts that it contains.

The present file of the same name may be missing or changed. It is only compared; a recording
without the text of its sensor uses it.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from mjtactile.core.design import SensorDesign, load_sensor, sensor_from_text
from mjtactile.core.errors import InputError
from mjtactile.recording.files import LOG, SENSORS, stored_file
from mjtactile.recording.reader import Recording

_DIGITS = 12  # characters of a checksum in a message
_logger = logging.getLogger(__name__)


def recorded_sensors(
    recording: Recording, requested: str | SensorDesign | None = None
) -> dict[str, SensorDesign]:
    """Read the sensor of each finger from the recording.

    A warning names each sensor file that has changed since the recording. A recording without the
    text of its sensor uses the file of the recorded name, with a warning.

    Args:
        recording: The recording.
        requested: Requested sensor, which must have the recorded values. None: no request.

    Returns:
        The sensors by finger.

    Raises:
        InputError: Another sensor is requested, or a recorded one is missing or wrong.
    """
    sensors = {finger: _sensor(recording, finger, requested) for finger in recording.fingers}
    if requested is not None:
        for finger, sensor in sensors.items():
            require_recorded(recording, finger, sensor, requested)
    for kind, file in recording.header.get("files", {}).items():
        _warn_if_changed(recording.folder, kind, file)
    return sensors


def require_recorded(
    recording: Recording, finger: str, sensor: SensorDesign, request: str | SensorDesign
) -> None:
    """Raise InputError if a finger was recorded with another sensor than `request`.

    `sensor` is the recorded one. The sensor of the recorded file is accepted too: `sensor` can
    differ from it by options such as a pressure.
    """
    requested = load_sensor(request)
    known = [sensor]
    if (stored := _file(recording, finger)) is not None:
        known.append(sensor_from_text(stored["text"], name="", source=stored["name"]))
    if any(requested.has_values_of(each) for each in known):
        return
    recorded = repr(sensor.name)
    if sensor.name == requested.name:
        recorded = f"other values of {recorded}"
    raise InputError(
        f"finger {finger!r} was recorded with {recorded}, not with the present {requested.name!r}; "
        "a recording is evaluated with its own sensor",
        source=recording.folder,
        field="--sensor",
    )


def _sensor(
    recording: Recording, finger: str, requested: str | SensorDesign | None
) -> SensorDesign:
    stored = recording.notes.get("sensors", {}).get(finger) or _file(recording, finger)
    if stored is not None:
        name = Path(stored["name"]).stem
        source = str(recording.folder / LOG)
        return sensor_from_text(stored["text"], name=name, source=source)
    if requested is not None:
        return load_sensor(requested)
    name = _name(recording, finger)
    message = f"{recording.folder} does not contain the text of its sensor"
    try:
        design = load_sensor(name)
    except InputError as error:
        raise InputError(f"{message}: {error}", field="--sensor") from error
    _warn(f"{message}; the present file {name!r} is used")
    return design


def _file(recording: Recording, finger: str) -> Mapping[str, str] | None:
    """Return the file of the finger's sensor, as the header contains it."""
    files = recording.header.get("files", {})
    is_own = finger in _own_names(recording)
    return files.get(f"sensor_{finger}" if is_own else "sensor")


def _name(recording: Recording, finger: str) -> str:
    scenario = recording.header.get("scenario") or {}
    common = recording.header.get("sensor") or scenario.get("sensor") or "dense"
    return str(_own_names(recording).get(finger, common))


def _own_names(recording: Recording) -> Mapping[str, Any]:
    scenario = recording.header.get("scenario") or {}
    return scenario.get("sensors") or {}


def _warn_if_changed(folder: Path, kind: str, file: Mapping[str, str]) -> None:
    where = SENSORS if kind.startswith("sensor") else None
    where = ("controllers", ".py") if kind == "controller" else where
    now = None if where is None else stored_file(file.get("name"), *where)
    recorded = file.get("sha256", "")
    if now is not None and now["sha256"] != recorded:
        _warn(
            f"{folder}: the {kind.partition('_')[0]} file {file['name']!r} has changed since the "
            f"recording (SHA-256 {recorded[:_DIGITS]}, now {now['sha256'][:_DIGITS]}); "
            + ("the present one runs" if kind == "controller" else "the recorded text is used")
        )


@cache
def _warn(text: str) -> None:
    """Log a warning once per process."""
    _logger.warning("%s", text)
