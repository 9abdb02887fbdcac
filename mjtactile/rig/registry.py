"""Builder of rigs: find the backend for the name that the user gives.

Backends are registered as entry points, the shipped ones and those of third parties alike. The
group `mjtactile.rigs` holds builders of whole rigs, `mjtactile.cameras` drivers of one camera. This
module imports no backend by name. There is no automatic fallback to another backend.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from mjtactile.core import resources
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.signature_checks import validated
from mjtactile.core.task import load_task
from mjtactile.rig.domain_randomization import NONE
from mjtactile.rig.file import RigFile, read_rig_file
from mjtactile.rig.finger import Rig
from mjtactile.rig.scenario import require_fingers, with_sensors
from mjtactile.rig.simulated import SimRigFile

_FIELDS = [name for name in Scenario.__dataclass_fields__ if name != "rig"]
RIGS = "mjtactile.rigs"
CAMERAS = "mjtactile.cameras"


@dataclass(frozen=True)
class RigRequest:
    """Request to a backend: the rig of `scenario`.

    `argument` is the folder of "replay:FOLDER", or `file` is the rig file. `design` is the sensor
    of fingers without their own.
    """

    scenario: Scenario
    design: SensorDesign
    argument: str = ""
    file: RigFile | SimRigFile | None = None


@validated()
def build_rig(scenario: Scenario | str, design: SensorDesign | None = None, **fields: Any) -> Rig:
    """Build the rig of a scenario.

    Args:
        scenario: A scenario; or the rig's name alone: "sim", "replay:FOLDER", a third party's, or a
            rig file (shipped or FILE.toml).
        design: Sensor on the fingers; only with a name.
        **fields: Other fields of the scenario; only with a name (`object_name` is its object).

    Returns:
        The rig; the caller must close it.

    Raises:
        InputError: An unknown rig, object or sensor.
        DeviceError: A device is missing.
    """
    requested = as_scenario(scenario, design, **fields)
    kind, request = request_of(requested)
    rig = load_backend(RIGS, kind)(request)
    try:
        _require_built(rig, requested)
    except InputError:
        rig.close()
        raise
    return replace(rig, goal=load_task(requested.task).goal.task_goal())


def request_of(requested: Scenario) -> tuple[str, RigRequest]:
    """Return the backend of a scenario's rig and the request to it; no device is opened.

    Raises InputError for an unknown rig, sensor or task, and for settings that the rig ignores.
    """
    name = requested.rig
    kind, _, argument = name.partition(":")
    file = None
    if argument and kind in SIMULATES:
        raise InputError(f"unknown rig {name!r}", field="--rig", choices=rig_names())
    if kind not in _entry_points(RIGS):
        shipped = resources.names("models/rigs", ".toml")
        if "." not in name and "/" not in name and name not in shipped:
            raise InputError(f"unknown rig {name!r}", field="--rig", choices=rig_names())
        file = with_sensors(read_rig_file(name), requested.sensors)
        argument = ""
        kind = file.backend
    if kind not in SIMULATES and (requested.accuracy, requested.effects) != ("", "auto"):
        raise InputError(
            f"the rig {name!r} is not a simulated rig", field="--accuracy or --effects"
        )
    if kind not in SIMULATES and requested.randomization != NONE:
        message = f"the rig {name!r} is not a simulated rig: its world cannot be randomized"
        raise InputError(message, field="--randomization", choices=[NONE])
    task = load_task(requested.task)
    if task.waypoints and kind not in MOVES_SIDEWAYS:
        text = f"the rig {name!r} does not move sideways, and the task {task.name!r} has waypoints"
        raise InputError(text, field="--rig", choices=["sim", "sim_arm", "sim_three_finger"])
    return kind, RigRequest(requested, requested.design(), argument, file)


def _require_built(rig: Rig, requested: Scenario) -> None:
    """Raise InputError if a finger has another sensor than the scenario names for it.

    A backend of another package may ignore them. The results would then state a wrong sensor.
    """
    built = {finger.name: finger.design.name for finger in rig.fingers}
    require_fingers(requested.rig, list(built), requested.sensors)
    for finger, sensor in requested.sensors.items():
        expected = load_sensor(sensor).name
        if built[finger] != expected:
            message = (
                f"the rig {requested.rig!r} has the sensor {built[finger]!r}, not {expected!r}"
            )
            raise InputError(message, field=f"sensors.{finger}", choices=[built[finger]])


def as_scenario(
    scenario: Scenario | str, design: SensorDesign | None = None, **fields: Any
) -> Scenario:
    """Return a scenario unchanged, or create one from a rig's name.

    A new scenario takes the sensor `design` for the fingers, and other fields. `object_name` is its
    object.
    """
    if isinstance(scenario, Scenario):
        given = [*fields, *([] if design is None else ["design"])]
        if given:
            message = "is already in the scenario; use dataclasses.replace to change it"
            raise InputError(message, source="scenario", field=given[0])
        return scenario
    if "object_name" in fields:
        fields["object"] = fields.pop("object_name")
    if design is not None:
        fields["sensor"] = design
    for name in fields:
        if name not in _FIELDS:
            raise InputError("is not a field", source="scenario", field=name, choices=_FIELDS)
    return Scenario(rig=scenario, **fields)


def require_file(request: RigRequest) -> RigFile:
    """Return the devices' rig file of a request. Raises InputError if there is none."""
    if not isinstance(request.file, RigFile):
        raise InputError("needs a rig file", field="--rig", choices=rig_names())
    return request.file


SIMULATES = ("sim",)
"""Rigs whose physics this process computes."""
MOVES_SIDEWAYS = (*SIMULATES, "replay")
"""Rigs that follow the waypoints of a task, or whose gripper has followed them."""


def rig_names() -> list[str]:
    """List the valid values of `--rig`.

    Returns:
        Shipped rigs, then the forms "FILE.toml" and "replay:FOLDER".
    """
    return [*resources.names("models/rigs", ".toml"), "FILE.toml", "replay:FOLDER"]


def load_backend(group: str, name: str) -> Callable[..., Any]:
    """Load the backend `name` from the entry point `group`. Raises InputError."""
    found = _entry_points(group)
    if name not in found:
        raise InputError(f"no backend {name!r} is installed", field=group, choices=sorted(found))
    try:
        return found[name].load()
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"backend {name!r} ({found[name].value}) does not load: {error}", field=group
        ) from error


def _entry_points(group: str) -> dict[str, EntryPoint]:
    return _installed(group, tuple(sys.path))


@cache
def _installed(group: str, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Return the entry points of a group, by name. The search reads a file of every package, so its
    result is stored per `path`."""
    return {point.name: point for point in entry_points(group=group)}
