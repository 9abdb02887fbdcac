"""Cases of `mjtactile bench references`.

Each is a TOML file with a sensor, one motion, and a reference with its source.

    about = "a ball at the center"          one-line description
    sensor = "dense"                        a shipped name, or FILE.toml next to the case
    friction = 0.9                          of the membrane, unless that of the sensor file
    law = "neo-Hookean"                     of the reference's rubber; the default, or
                                            "St. Venant-Kirchhoff"

    [press]                                 the motion: press, bulge, hold, held_shear, slide, spin
    indenter = "sphere:8"                   as for `mjtactile press`; a FILE.stl or FILE.xml next to
                                            the case
    at_mm = [0.0, 0.0]
    force = [[1.0, 0.112], [2.0, 0.302]]    depth below first touch, mm, and normal force, N

    [reference]
    source = "who computed or measured it, and how"
    percent = 5.0                           required: within this percentage of the reference,
    tolerance_min = 0.01                    or within this, in the unit of the reference
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mjtactile.core import resources
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.neo_hookean import Law
from mjtactile.core.toml import Section, read_toml

FOLDER = "models/reference_cases"
_LARGE = 1e9


@dataclass(frozen=True, eq=False)
class Case:
    """One case.

    `motion` names its kind. `plan` holds the values read for that kind by `MOTIONS`, in the file's
    units. Each number must lie within `percent` of its reference or within `tolerance_min` of it.
    """

    name: str
    about: str
    design: SensorDesign
    motion: str
    plan: dict[str, Any]
    source: str
    percent: float
    minimum: float
    path: Path

    def allows(self, reference: float) -> float:
        """Return the allowed deviation from `reference`."""
        return max(self.minimum, 1e-2 * self.percent * abs(reference))


def _press(s: Section) -> dict[str, Any]:
    return {
        "indenter": s.text("indenter"),
        "at_mm": s.numbers("at_mm", "xy", -100, 100, default=(0.0, 0.0)),
        "force": s.pairs("force") if s.has("force") else (),
        "drag_mm": s.number("drag_mm", -20, 20, default=0.0),
        "depth_mm": s.number("depth_mm", 0, 50, default=None),
        "shear": s.numbers("shear", ("Fx", "Fy"), -_LARGE, _LARGE, default=None),
        "is_estimated": s.flag("estimate", True),
    }


def _bulge(s: Section) -> dict[str, Any]:
    return {"height": s.pairs("height")}


def _pinch(s: Section) -> dict[str, Any]:
    return {
        "body": s.text("body", ("sphere", "box", "plate", "rod")),
        "size_mm": s.number("size_mm", 0.1, 100),
        "mass_g": s.number("mass_g", 0.01, 1e4),
        "squeeze_mm": s.number("squeeze_mm", 0, 20),
        "seconds": s.number("seconds", 0.1, 100, default=2.0),
        "timestep_ms": _steps(s),
    }


def _drag(s: Section) -> dict[str, Any]:
    return {
        "indenter": s.text("indenter"),
        "depth_mm": s.number("depth_mm", 0, 50),
        "drag_mm": s.number("drag_mm", -20, 20),
        "speed_mm_s": s.number("speed_mm_s", 0.01, 1000, default=20.0),
        "seconds": s.number("seconds", 0.1, 100, default=10.0),
        "timestep_ms": _steps(s),
    }


def _spin(s: Section) -> dict[str, Any]:
    return {
        "axis": s.numbers("axis", "xyz", -1, 1),
        "speed_rad_s": s.number("speed_rad_s", 0.01, 100, default=1.0),
        "seconds": s.number("seconds", 0.1, 100, default=1.0),
        "timestep_ms": _steps(s),
    }


def _steps(s: Section) -> tuple[float, ...]:
    steps = tuple(float(step) for step in s.array("timestep_ms", (None,)))
    if not steps or not all(0.1 <= step <= 20 for step in steps):
        raise s.fail("timestep_ms", f"{list(steps)} is not a list of steps of 0.1 to 20 ms")
    return steps


MOTIONS: dict[str, Callable[[Section], dict[str, Any]]] = {
    "press": _press,
    "bulge": _bulge,
    "hold": _pinch,
    "held_shear": _drag,
    "slide": _drag,
    "spin": _spin,
}
"""Readers of the sections, by name of the motion."""


def load_case(path: Path) -> Case:
    """Read one case. Raises InputError naming file, field and choices."""
    file = Section(read_toml(path), "", str(path))
    sections = {name: section for name in MOTIONS if (section := file.optional(name)) is not None}
    if len(sections) != 1:
        raise InputError(
            f"{len(sections)} motions, expected one",
            source=path,
            field="[motion]",
            choices=list(MOTIONS),
        )
    ((motion, section),) = sections.items()
    plan = MOTIONS[motion](section)
    section.done()
    reference = file.section("reference")
    name = file.text("sensor")
    design = load_sensor(path.parent / name if name.endswith(".toml") else name)
    friction = file.number("friction", 0.0, 10.0, default=design.membrane.friction)
    law = Law(file.text("law", tuple(Law), default=design.membrane.law))
    design = replace(design, membrane=replace(design.membrane, friction=friction, law=law))
    case = Case(
        path.stem,
        file.text("about"),
        design,
        motion,
        plan,
        reference.text("source"),
        reference.number("percent", 0.0, 1000.0),
        reference.number("tolerance_min", 0.0, _LARGE),
        path,
    )
    reference.done()
    file.done()
    return case


def load_cases(folder: Path | None = None) -> list[Case]:
    """Load all cases of a folder, by default the shipped ones.

    Raises:
        InputError: The folder has no case.
    """
    folder = resources.folder(FOLDER) if folder is None else folder
    paths = sorted(folder.glob("*.toml"))
    # the others are sensors
    paths = [path for path in paths if any(key in read_toml(path) for key in MOTIONS)]
    if not paths:
        raise InputError(
            "no case (a TOML file with a motion)",
            source=folder,
            field="--cases",
            choices=list(MOTIONS),
        )
    return [load_case(path) for path in paths]
