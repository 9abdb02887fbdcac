"""`Scenario`: definition of one run: object, task, controller, rig, sensors, and more.

It also holds the simulation and the seed. The command line creates it, and files describe it.
Results and recordings store it. All functions that run an episode take it. Speed and place of
execution are not part of it. A scenario with the same versions yields the same results.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from mjtactile.core import foreign_file, resources
from mjtactile.core.config_fields import entry, flag, integer
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.effect_names import read_switches
from mjtactile.core.errors import InputError
from mjtactile.core.fidelity_levels import read_accuracy
from mjtactile.core.field_types import Entry, Number
from mjtactile.core.signature_checks import validated, within
from mjtactile.core.toml import Section

TIME_LIMIT = 60.0  # default limit on the rig's clock, s; a gentle grasp takes about 10


@dataclass(frozen=True, kw_only=True)
class FileName(Entry):
    """File with `suffix`, or the name of a file shipped in `folder`.

    The path is resolved relative to the file that names it, then as written. `others` are further
    valid names.
    """

    folder: str
    suffix: str
    others: tuple[str, ...] = ()

    def read(self, section: Section, default: Any) -> str:
        """Return the name, or the path of the file."""
        return self.read_key(section, self.key, default)

    def read_key(self, section: Section, key: str, default: Any = ...) -> str:
        """Return the name, or the path of the file, of another key; see `read`."""
        value = section.text(key, default=default)
        shipped = [*resources.names(self.folder, self.suffix), *self.others]
        choices = [*shipped, f"FILE{self.suffix}"]
        if value.endswith(self.suffix) or ("/" in value and ":" not in value):
            if not value.endswith(self.suffix):
                raise section.fail(key, f"{value!r} does not end in {self.suffix}", choices)
            written = foreign_file.user_path(value)
            relative = section.folder / written
            if foreign_file.is_file(relative):
                return str(relative)
            if not foreign_file.is_file(written):
                raise section.fail(key, f"no such file: {value!r}", choices)
        elif value not in shipped and not self._may_be(value):
            raise section.fail(key, f"{value!r} is unknown", choices)
        return value

    def _may_be(self, value: str) -> bool:
        """Return True if the name is checked later, when it is used. Installed backends have their
        own names."""
        return ":" in value or self.key == "rig"


@dataclass(frozen=True, kw_only=True)
class _EachFinger(Entry):
    """A section: finger to the file's name."""

    name: FileName

    def read(self, section: Section, default: Any) -> dict[str, str]:
        fields = section.optional(self.key)
        if fields is None:
            return {}
        return {finger: self.name.read_key(fields, finger) for finger in section.table(self.key)}


@dataclass(frozen=True, kw_only=True)
class _Limit(Number):
    """Number, or null, which represents infinity in JSON."""

    def read(self, section: Section, default: Any) -> Any:
        return super().read(section, math.inf if section.has(self.key) else default)


@dataclass(frozen=True, kw_only=True)
class _CheckedText(Entry):
    """Text that `check` of text and field accepts; with `empty` it may be empty."""

    check: Callable[[str, str], object]
    empty: bool = False

    def read(self, section: Section, default: Any) -> Any:
        value = section.text(self.key, default=default, empty=self.empty)
        try:
            _check_if_given(self.check, value, self.key)
        except InputError as error:
            raise section.moved(self.key, error) from None
        return value


def _check_if_given(check: Callable[[str, str], object], value: str, field: str) -> None:
    """Raise InputError for a text that is neither empty nor accepted."""
    if value:
        check(value, field)


_SENSOR = FileName(key="sensor", folder="models/sensors", suffix=".toml")


def _file(key: str, folder: str, suffix: str, *others: str, default: str) -> Any:
    return entry(FileName(key=key, folder=folder, suffix=suffix, others=others), default)


@validated(seed=within(0, 2**63 - 1))
@dataclass(frozen=True)
class Scenario:
    """One run. Names are of shipped files, or paths of a user's own. Every field has a default.

    Attributes:
        object: Object to grasp: a shipped name, FILE.xml or "random:N".
        task: Task with the object: a shipped name, or FILE.toml.
        controller: Shipped name or FILE.py.
        rig: Shipped name, FILE.toml, "replay:FOLDER", or that of an installed backend.
        sensor: Sensor on each finger: shipped name, FILE.toml, or a design created in memory.
        sensors: Sensors by finger, if different from `sensor`, as that. They override the rig file.
        effects: Simulated effects: "auto", or "+NAME,-NAME".
        accuracy: Accuracy of the simulation: "" (default), "0.02N" or "realtime".
        randomization: Ranges from which the seed randomizes the world: shipped name, FILE.toml, or
            "none".
        seed: Seed of camera noise, of the object's position, and of `randomization`.
        time_limit: Time on the rig's clock after which the run is ended, s; inf: never.
        contact_shapes: True if force and slip come from the contact shape, regardless of the
            controller. Area and kind always do.

    Raises:
        InputError: For a seed or time limit out of range, or wrong effects or accuracy.
    """

    object: str = _file("object", "models/objects", ".xml", "random:N", default="egg")
    task: str = _file("task", "models/tasks", ".toml", default="lift")
    controller: str = _file("controller", "controllers", ".py", default="adaptive")
    rig: str = _file("rig", "models/rigs", ".toml", "replay:FOLDER", default="sim")
    sensor: str | SensorDesign = entry(_SENSOR, "dense")
    sensors: Mapping[str, str | SensorDesign] = entry(
        _EachFinger(key="sensors", name=_SENSOR), default_factory=dict, hash=False
    )
    effects: str = entry(_CheckedText(key="effects", check=read_switches), "auto")
    accuracy: str = entry(_CheckedText(key="accuracy", check=read_accuracy, empty=True), "")
    randomization: str = _file(
        "randomization", "models/randomization", ".toml", "none", default="none"
    )
    seed: int = integer("seed", 0, 2**63 - 1, default=0)
    time_limit: float = entry(_Limit(key="time_limit_s", low=0.1, high=86400), TIME_LIMIT)
    contact_shapes: bool = flag("contact_shapes", default=False)

    def __post_init__(self) -> None:
        if not self.time_limit > 0:
            raise InputError(f"{self.time_limit:g} is not above 0", field="time_limit_s")
        _check_if_given(read_switches, self.effects, "effects")
        _check_if_given(read_accuracy, self.accuracy, "accuracy")

    def design(self) -> SensorDesign:
        """Read the sensor of the fingers that have none of their own.

        Returns:
            The sensor.

        Raises:
            InputError: For a sensor file that is missing or wrong.
        """
        return load_sensor(self.sensor)

    @property
    def given(self) -> set[str]:
        """Names of the fields that differ from their defaults."""
        default = Scenario()
        return {f.name for f in fields(self) if getattr(self, f.name) != getattr(default, f.name)}

    @property
    def sensor_name(self) -> str:
        """Name of `sensor` in files: a shipped name, or the path of a user's file."""
        return _name(self.sensor)

    @property
    def finger_sensor_names(self) -> dict[str, str]:
        """Descriptions of `sensors`, by finger."""
        return {finger: _name(sensor) for finger, sensor in self.sensors.items()}

    def to_dict(self) -> dict[str, Any]:
        """Convert to a dictionary.

        Returns:
            The scenario as files and results keep it. `mjtactile.load_scenario` reads it again.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        limit = values.pop("time_limit")
        if not self.contact_shapes:  # results of earlier versions have no such key
            del values["contact_shapes"]
        return values | {
            "sensor": self.sensor_name,
            "sensors": self.finger_sensor_names,
            "time_limit_s": limit,
        }

    def header(self) -> dict[str, Any]:
        """Return the description of the run for a recording.

        Returns:
            The scenario, the command to run it again, and the contents of sensors that are given
            by their values (those of files are added by the recorder).
        """
        values = self.to_dict()
        names = {key: values[key] for key in ("object", "sensor", "controller", "rig", "seed")}
        by_finger = {f"sensor_{finger}": sensor for finger, sensor in self.sensors.items()}
        files = {
            key: sensor.stored_file()
            for key, sensor in {"sensor": self.sensor, **by_finger}.items()
            if isinstance(sensor, SensorDesign)
        }
        return names | {"command": self.command(), "scenario": values, "files": files}

    def names(self) -> dict[str, Any]:
        """Return the description of the run for its summary.

        Returns:
            The names of object, sensor and controller, and the seed.
        """
        sensors = {self.sensor_name: None} | dict.fromkeys(self.finger_sensor_names.values())
        return {
            "object": Path(self.object).stem,
            "sensor": ", ".join(Path(name).stem for name in sensors),
            "controller": Path(self.controller).stem,
            "seed": self.seed,
        }

    def command(self) -> str:
        """Return the command to run it again.

        Returns:
            The command, for a shell.
        """
        words = ["mjtactile", "grasp", "--object", self.object]
        words += ["--controller", self.controller, "--seed", str(self.seed)]
        values = self.to_dict()
        if isinstance(self.sensor, SensorDesign):
            del values["sensor"]  # no file has these values
        for name in ("task", "sensor", "rig", "accuracy", "effects", "randomization"):
            if values.get(name, _DEFAULTS[name]) != _DEFAULTS[name]:
                words.append(f"--{name}={values[name]}")
        words += ["--contact-shapes"] if self.contact_shapes else []
        return shlex.join(words)


def _name(sensor: str | SensorDesign) -> str:
    return sensor.name if isinstance(sensor, SensorDesign) else sensor


_DEFAULTS = Scenario().to_dict()
