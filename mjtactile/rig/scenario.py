"""Read a scenario from a file or from a run's result, and complete it from its rig file.

For the format see docs/reference/scenario_files.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from mjtactile.core import foreign_file, resources
from mjtactile.core.config_fields import read
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.signature_checks import shown, validated
from mjtactile.core.toml import Section, read_json, read_toml
from mjtactile.recording.reader import Recording, load_recording
from mjtactile.recording.recorded_sensors import recorded_sensors, require_recorded
from mjtactile.rig.file import RigFile, read_rig_file
from mjtactile.rig.simulated import SimRigFile


@validated()
def load_scenario(source: str | Path) -> Scenario:
    """Read a scenario from a TOML file, or from the `summary.json` of a run.

    Files that a scenario names are searched relative to it first, then by their own path.

    Args:
        source: The file; in a JSON file, the entry "scenario" is read.

    Returns:
        The scenario; missing fields have their defaults.

    Raises:
        InputError: A value is missing or wrong; the error names file, field, value and valid
            choices.
    """
    path = foreign_file.user_path(source)
    if path.suffix not in (".toml", ".json"):
        raise InputError(
            f"{path.suffix or 'no suffix'!r} is not a scenario format",
            source=path,
            field="--scenario",
            choices=["FILE.toml", "RUN/summary.json"],
        )
    if path.suffix == ".toml":
        return scenario_from_table(read_toml(path), path)
    content = read_json(path)
    table = content.get("scenario") if isinstance(content, Mapping) else None
    if not isinstance(table, Mapping):
        raise InputError("contains no scenario", source=path, field="scenario")
    return scenario_from_table(table, path, label="scenario")


def scenario_from_table(table: Mapping[str, Any], path: Path, label: str = "") -> Scenario:
    """Validate a parsed table of the file `path`; see `load_scenario`."""
    return read(Scenario, Section(table, label, str(path)))


@validated()
def resolve_scenario(scenario: Scenario, given: Sequence[str] | None = None) -> Scenario:
    """Fill in the actual sensor of each of the rig's fingers, and the facts of a replayed run.

    The fingers of a rig file may name their own sensors. A sensor common to all fingers becomes the
    scenario's `sensor`. A recording is replayed with the sensors that it contains. Its object,
    task, controller, seed and time limit apply unless others are given. It is replayed with shapes
    if it has them.

    Args:
        scenario: The requested scenario.
        given: Names of the fields that the user gave; None: those that differ from the defaults.

    Returns:
        The scenario with its sensors, and for a recording with its facts.

    Raises:
        InputError: The rig file is missing or wrong, a given name is no field, or a recording has
            another sensor than the given one.
    """
    for name in given or ():
        if name not in Scenario.__dataclass_fields__:
            message = f"{shown(name)} is not a field of a scenario"
            choices = Scenario.__dataclass_fields__
            raise InputError(message, source="resolve_scenario", field="given", choices=choices)
    backend, _, folder = scenario.rig.partition(":")
    if backend == "replay":
        chosen = tuple(scenario.given) if given is None else given
        return _replayed(scenario, load_recording(folder), chosen)
    given_by_values = any(isinstance(own, SensorDesign) for own in scenario.sensors.values())
    if given_by_values or not _is_file(scenario.rig):
        return scenario
    default = scenario.sensor_name
    file = with_sensors(read_rig_file(scenario.rig), scenario.sensors)
    fitted = {name: sensor or default for name, sensor in _fitted(file).items()}
    kinds = set(fitted.values())
    if kinds == {default}:
        return replace(scenario, sensors={})
    if len(kinds) == 1:
        return replace(scenario, sensor=kinds.pop(), sensors={})
    own = {name: sensor for name, sensor in fitted.items() if sensor != default}
    return replace(scenario, sensors=own)


def _fitted(file: RigFile | SimRigFile) -> dict[str, str | None]:
    """Return the sensor of each finger in the file; None: the scenario's sensor applies."""
    if isinstance(file, RigFile):
        return {camera.finger: camera.sensor for camera in file.cameras}
    sensors = {finger.name: finger.sensor for finger in file.fingers}
    return {
        name: sensor.name if isinstance(sensor, SensorDesign) else sensor
        for name, sensor in sensors.items()
    }


_File = TypeVar("_File", bound=RigFile | SimRigFile)


def with_sensors(file: _File, sensors: Mapping[str, str | SensorDesign]) -> _File:
    """Return the rig file with these sensors on these fingers. Raises InputError for a finger that
    the rig does not have."""
    require_fingers(file.name, list(_fitted(file)), sensors)
    if isinstance(file, RigFile):
        cameras = (replace(c, sensor=sensors.get(c.finger, c.sensor)) for c in file.cameras)
        return replace(file, cameras=tuple(cameras))
    fingers = (replace(f, sensor=sensors.get(f.name, f.sensor)) for f in file.fingers)
    return replace(file, fingers=tuple(fingers))


def require_fingers(rig: str, fingers: Sequence[str], named: Iterable[str]) -> None:
    """Raise InputError if a named finger is not among the `fingers` of the `rig`."""
    for name in named:
        if name not in fingers:
            raise InputError(f"{rig} has no finger {name!r}", field="sensors", choices=fingers)


def _is_file(rig: str) -> bool:
    return rig.endswith(".toml") or "/" in rig or rig in resources.names("models/rigs", ".toml")


_OF_A_RUN = ("object", "task", "controller", "seed", "time_limit")
"""Fields of a replayed run that apply unless others are given."""


def _replayed(scenario: Scenario, recording: Recording, given: Sequence[str]) -> Scenario:
    """Return the scenario of a replay."""
    sensors = recorded_sensors(recording, scenario.sensor if "sensor" in given else None)
    if not sensors:
        return scenario  # it has no cycles, and cannot be replayed
    for finger, requested in scenario.sensors.items() if "sensors" in given else ():
        if finger not in sensors:
            message = f"was recorded without a finger {finger!r}"
            raise InputError(message, source=recording.folder, field="sensors", choices=sensors)
        require_recorded(recording, finger, sensors[finger], requested)
    kept = {
        name: value
        for name, value in _run_fields(recording).items()
        if name in _OF_A_RUN and name not in given
    }
    first, *_ = sensors.values()
    return replace(
        scenario,
        **kept,
        sensor=first,
        sensors={
            finger: sensor for finger, sensor in sensors.items() if not sensor.has_values_of(first)
        },
        contact_shapes=scenario.contact_shapes or recording.has_shape_forces,
    )


def _run_fields(recording: Recording) -> dict[str, Any]:
    """Return the fields of the recorded scenario, with the names of `Scenario`."""
    scenario = recording.header.get("scenario")
    found = dict(scenario) if isinstance(scenario, Mapping) else {}
    if "time_limit_s" in found:
        limit = found.pop("time_limit_s")
        found["time_limit"] = math.inf if limit is None else limit
    return {name: value for name, value in found.items() if value is not None}
