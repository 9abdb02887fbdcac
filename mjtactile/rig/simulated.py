"""Simulated rig of a rig file: the user's MJCF, its fingertip sites, jaws and lift.

The format is described in docs/reference/rig_files.md. Every quantity is SI inside; the file's keys
carry the unit. Names of sites, actuators and bodies are those of the MJCF. They are resolved when
the rig is built.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mjtactile.core import foreign_file
from mjtactile.core.config_fields import (
    DEGREE,
    KPA,
    MM,
    entry,
    file_path,
    flag,
    given,
    number,
    part,
    parts,
    read,
    read_fields,
    text,
)
from mjtactile.core.design import SensorDesign
from mjtactile.core.field_types import FilePath, Span, Texts
from mjtactile.core.toml import Section
from mjtactile.rig.jaw_transmission import CRANK, LINEAR, TABLE, JawLaw, make_law

FINGERS_MAX = 8
LAWS = {
    "rack": (LINEAR, "mm_per_rad"),
    "slide": (LINEAR, "mm_per_mm"),
    "tendon": (LINEAR, "mm_per_mm"),
    "crank": (CRANK, "mm_per_rad"),
    "table": (TABLE, ""),
}
"""Law to its kind and to the key of its ratio."""
OPENING = Span(key="opening_max_mm", low_key="opening_min_mm", low=0, high=1000, unit=MM)
"""Opening range of real and simulated jaws."""
_PER = {"mm_per_rad": 1e-3, "mm_per_mm": 1.0}


@dataclass(frozen=True)
class SimFingerConfig:
    """Finger of a simulated rig.

    `site` is the MJCF site of its sensor (z points outward, to the object). `sensor` is its file,
    shipped name or design (None: the one of the command).
    """

    name: str = text("name")
    site: str = text("site")
    sensor: str | SensorDesign | None = file_path("sensor", shipped=True)

    def validate(self, section: Section) -> None:
        """Raise InputError for a name that a simulated scene cannot hold."""
        if "/" in self.name:
            message = f"{self.name!r} contains a slash, which separates names in a simulated scene"
            raise section.fail("name", message)
        if not self.name.isprintable():
            raise section.fail("name", f"{self.name!r} contains a control character")


@dataclass(frozen=True)
class SimActuator:
    """Position actuator that moves jaws; `transmission` maps its length to a part of the
    opening."""

    name: str
    transmission: JawLaw

    @classmethod
    def from_section(cls, section: Section) -> SimActuator:
        """Read an actuator with its law. Raises InputError for a law without an inverse."""
        law = section.text("transmission", LAWS)
        kind, key = LAWS[law]
        offset = 0.0
        ratio = 0.0
        table = ()
        if kind == TABLE:
            key = "table_mm_mm" if section.has("table_mm_mm") else "table_deg_mm"
            unit = MM if key == "table_mm_mm" else DEGREE
            table = tuple((a * unit, x * MM) for a, x in section.pairs(key))
        else:
            ratio = section.number(key, -500, 500, _PER[key])
            offset = section.number("jaw_offset_mm", -500, 500, MM, default=0.0)
        try:
            return cls(section.text("name"), make_law(kind, offset, ratio, table))
        except ValueError as error:
            raise section.fail(key, str(error)) from error


@dataclass(frozen=True)
class SimGripperConfig:
    """Jaws: `opening` m (lowest, highest), `start` m, `force_max` N on each finger, `speed` m/s of
    the opening, `backlash` m, a gear play that is compensated.
    """

    opening: tuple[float, float]
    start: float
    actuators: tuple[SimActuator, ...] = parts("actuator", SimActuator, high=FINGERS_MAX)
    force_max: float = number("force_max_N", 0.1, 500, default=8.0)
    speed: float = number("speed_max_mm_s", 0.1, 1000, MM, default=0.05)
    backlash: float = number("backlash_mm", 0, 5, MM, default=0.0)

    @classmethod
    def from_section(cls, section: Section) -> SimGripperConfig:
        """Read the jaws; the default of their initial opening is the maximum."""
        opening = OPENING.read(section, ...)
        low, high = opening
        low_mm = low / MM - 1e-6
        high_mm = high / MM + 1e-6
        start = section.number("opening_start_mm", low_mm, high_mm, MM, default=high)
        return read(cls, section, opening=opening, start=start)


@dataclass(frozen=True)
class SimLift:
    """Lift of the gripper by `travel`, m, at `speed`, m/s.

    The values of `kind`:

    - "actuator": the position actuator `name`, with `ratio` m of height per unit of its length;
    - "mocap": the mocap body `name`;
    - "arm": the position actuators `actuators` (empty: all on joints between the world and the
      gripper);
    - "none": no lift; the requested height is reported as reached.
    """

    kind: str = text("kind", ("actuator", "mocap", "arm", "none"))
    travel: float = number("travel_mm", 1, 5000, MM, default=0.15)
    speed: float = number("speed_max_mm_s", 0.1, 1000, MM, default=0.05)
    name: str = ""
    ratio: float = 1.0
    actuators: tuple[str, ...] = entry(Texts(key="actuators", only_if=("kind", ("arm",))), ())

    @classmethod
    def from_section(cls, section: Section) -> SimLift:
        """Read a lift with the keys of its kind."""
        lift = cls(**read_fields(cls, section))
        if lift.kind == "mocap":
            return replace(lift, name=section.text("body"))
        if lift.kind != "actuator":
            return lift
        key = "mm_per_rad" if section.has("mm_per_rad") else "mm_per_mm"
        ratio = section.number(key, -500, 500, _PER[key], default=1.0)
        if ratio == 0:
            raise section.fail(key, "0 moves nothing")
        return replace(lift, name=section.text("actuator"), ratio=ratio)


@dataclass(frozen=True)
class SimAir:
    """Range of the valves: `pressure_max`, Pa above ambient, and `pressure_rate`, Pa/s, for a
    controller."""

    pressure_max: float = number("pressure_max_kPa", 0.01, 1000, KPA, default=3000.0)
    pressure_rate: float = number("pressure_rate_kPa_s", 0.01, 100, KPA, default=1200.0)


@dataclass(frozen=True)
class _World:
    """Section [sim]: the robot and its support."""

    model: Path = entry(FilePath(key="model"))
    keyframe: str | None = text("keyframe", default=None)
    table: bool = flag("table", default=True)
    table_height: float = number("table_height_mm", -10000, 10000, MM, default=0.0)

    def validate(self, section: Section) -> None:
        """Raise InputError where the model is not there."""
        if not foreign_file.is_file(self.model):
            raise section.fail("model", f"no such file: {self.model}")


@dataclass(frozen=True)
class SimRigFile:
    """Simulated rig.

    `model` is its MJCF. The initial state is the `keyframe` (None: the MJCF's default). If `table`
    is True, a table is added below the gripper; otherwise the MJCF contains one. Its top is at
    `table_height`, m.
    """

    name: str = text("name")
    path: Path = given()
    model: Path = given()
    fingers: tuple[SimFingerConfig, ...] = parts("finger", SimFingerConfig, high=FINGERS_MAX)
    gripper: SimGripperConfig = part("gripper", SimGripperConfig)
    lift: SimLift = part("lift", SimLift)
    air: SimAir = part("air", SimAir, default=SimAir())
    keyframe: str | None = None
    table: bool = True
    table_height: float = 0.0

    backend = "sim"

    def validate(self, section: Section) -> None:
        """Raise InputError for two fingers of one name."""
        names = [finger.name for finger in self.fingers]
        for name in names:
            if names.count(name) > 1:
                message = f"{names.count(name)} fingers are named {name!r}"
                raise section.fail("finger.name", message)


def sim_rig_from_table(table: Mapping[str, Any], path: Path) -> SimRigFile:
    """Validate the sections of the rig file `path`, with a section [sim].

    File names in it are relative to its folder. Raises InputError that names file, field, value and
    valid choices.
    """
    root = Section(table, "", str(path))
    world = read(_World, root.section("sim"))
    name = root.text("name", default=path.stem)
    return read(SimRigFile, root, name=name, path=path, **vars(world))
