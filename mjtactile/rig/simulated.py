"""A rig file's simulated rig: the user's MJCF, its fingertip sites, jaws and lift. The format:
docs/robots.md.

Every quantity is SI inside; the file's keys carry the unit. Names of sites, actuators and bodies
are those of the MJCF, and are looked up when the rig is built.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjtactile.core.design import SensorDesign
from mjtactile.core.toml import Section
from mjtactile.rig.jaws import CRANK, LINEAR, TABLE, JawLaw, make_law

FINGERS_MAX = 8
LAWS = {
    "rack": (LINEAR, "mm_per_rad"),
    "slide": (LINEAR, "mm_per_mm"),
    "tendon": (LINEAR, "mm_per_mm"),
    "crank": (CRANK, "mm_per_rad"),
    "table": (TABLE, ""),
}
"""Law to its kind and to the key of its ratio."""
_PER = {"mm_per_rad": 1e-3, "mm_per_mm": 1.0}


@dataclass(frozen=True)
class SimFinger:
    """A finger: the `site` of the MJCF that carries its sensor (z points at the object, out of the
    sensor), and the `sensor`: its file, shipped name or design (None: the one that the command
    names)."""

    name: str
    site: str
    sensor: str | SensorDesign | None = None


@dataclass(frozen=True)
class SimActuator:
    """A position actuator that moves jaws; `law` says what part of the opening its length makes."""

    name: str
    law: JawLaw


@dataclass(frozen=True)
class SimGripper:
    """Jaws: `opening` m (lowest, highest), `start` m, `force_max` N on each finger, `speed` m/s of
    the opening."""

    opening: tuple[float, float]
    start: float
    actuators: tuple[SimActuator, ...]
    force_max: float = 8.0
    speed: float = 0.05


@dataclass(frozen=True)
class SimLift:
    """What lifts the hand by `travel` m at `speed` m/s. By `kind`:

    "actuator": the position actuator `name`, by `ratio` m of height for each unit of its length;
    "mocap": the mocap body `name`; "arm": the position actuators `actuators` (empty: all on joints
    between the world and the hand); "none": nothing, and the height that was asked for is reported
    as reached.
    """

    kind: str
    travel: float = 0.15
    speed: float = 0.05
    name: str = ""
    ratio: float = 1.0
    actuators: tuple[str, ...] = ()


@dataclass(frozen=True)
class SimRigFile:
    """A simulated rig. `model` is its MJCF; it starts in the `keyframe` (None: as the MJCF stands);
    a `table` is put under the hand, or the MJCF has its own; its top is at `table_height` m."""

    name: str
    path: Path
    model: Path
    fingers: tuple[SimFinger, ...]
    gripper: SimGripper
    lift: SimLift
    keyframe: str | None = None
    table: bool = True
    table_height: float = 0.0

    backend = "sim"


def sim_rig_from_table(table: Mapping[str, Any], path: Path) -> SimRigFile:
    """Validate a parsed TOML table with a section [sim]. Raises InputError naming file, field,
    value and valid choices."""
    root = Section(table, "", str(path))
    name = root.text("name", default=path.stem)
    sim = root.section("sim")
    fingers = _fingers(root, path)
    gripper = _gripper(root.section("gripper"))
    lift = _lift(root.section("lift"))
    root.done()
    model = path.parent / sim.text("model")
    if not model.is_file():
        raise sim.fail("model", f"no such file: {model}")
    rig = SimRigFile(
        name,
        path,
        model,
        fingers,
        gripper,
        lift,
        keyframe=sim.text("keyframe", default=None),
        table=sim.flag("table", True),
        table_height=sim.number("table_height_mm", -10000, 10000, 1e-3, default=0.0),
    )
    sim.done()
    return rig


def _fingers(root: Section, path: Path) -> tuple[SimFinger, ...]:
    fingers = tuple(_finger(section, path) for section in root.sections("finger", high=FINGERS_MAX))
    names = [finger.name for finger in fingers]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise root.fail("finger.name", f"{names.count(twice)} fingers are named {twice!r}")
    return fingers


def _finger(section: Section, path: Path) -> SimFinger:
    finger = SimFinger(
        section.text("name"), section.text("site"), section.text("sensor", default=None)
    )
    if "/" in finger.name:
        raise section.fail(
            "name", f"{finger.name!r} has a slash, which parts names of a simulated scene"
        )
    section.done()
    if isinstance(finger.sensor, str) and (path.parent / finger.sensor).is_file():
        return SimFinger(finger.name, finger.site, str(path.parent / finger.sensor))
    return finger


def _gripper(section: Section) -> SimGripper:
    low = section.number("opening_min_mm", 0, 1000, 1e-3, default=0.0)
    high = section.number("opening_max_mm", 0, 1000, 1e-3)
    if high <= low:
        raise section.fail(
            "opening_max_mm", f"{high * 1e3:g} is not above opening_min_mm = {low * 1e3:g}"
        )
    start = section.number(
        "opening_start_mm", low * 1e3 - 1e-6, high * 1e3 + 1e-6, 1e-3, default=high
    )
    gripper = SimGripper(
        (low, high),
        start,
        tuple(map(_actuator, section.sections("actuator", high=FINGERS_MAX))),
        force_max=section.number("force_max_N", 0.1, 500, default=8.0),
        speed=section.number("speed_max_mm_s", 0.1, 1000, 1e-3, default=0.05),
    )
    section.done()
    return gripper


def _actuator(section: Section) -> SimActuator:
    law = section.text("law", LAWS)
    kind, key = LAWS[law]
    offset = 0.0
    ratio = 0.0
    table = ()
    if kind == TABLE:
        key = "table_mm_mm" if section.has("table_mm_mm") else "table_deg_mm"
        unit = 1e-3 if key == "table_mm_mm" else math.radians(1)
        table = tuple((a * unit, 1e-3 * x) for a, x in section.pairs(key))
    else:
        ratio = section.number(key, -500, 500, _PER[key])
        offset = section.number("opening_part_mm", -500, 500, 1e-3, default=0.0)
    try:
        actuator = SimActuator(section.text("name"), make_law(kind, offset, ratio, table))
    except ValueError as error:
        raise section.fail(key, str(error)) from error
    section.done()
    return actuator


def _lift(section: Section) -> SimLift:
    kind = section.text("kind", ("actuator", "mocap", "arm", "none"))
    travel = section.number("travel_mm", 1, 5000, 1e-3, default=0.15)
    speed = section.number("speed_max_mm_s", 0.1, 1000, 1e-3, default=0.05)
    name = ""
    ratio = 1.0
    actuators = ()
    if kind == "actuator":
        name = section.text("actuator")
        key = "mm_per_rad" if section.has("mm_per_rad") else "mm_per_mm"
        ratio = section.number(key, -500, 500, _PER[key], default=1.0)
        if ratio == 0:
            raise section.fail(key, "0 moves nothing")
    elif kind == "mocap":
        name = section.text("body")
    elif kind == "arm":
        actuators = section.texts("actuators") if section.has("actuators") else ()
    section.done()
    return SimLift(kind, travel, speed, name, ratio, actuators)
