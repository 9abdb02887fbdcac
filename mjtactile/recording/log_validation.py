"""Validation of a recording's log: kinds and shapes of all values.

A recording may come from an unknown source, or be damaged on disk. After this validation the
reader's users need no checks of their own.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Mapping
from pathlib import PurePosixPath
from typing import Any

from mjtactile.core.types import COMMAND_FIELDS

FLAG = "true or false"
NUMBER = "a number"
TEXT = "text"
TABLE = "a table"
_KINDS = {"number": NUMBER, "text": TEXT, "phase": TEXT, "table": TABLE}
_ONE = {
    **{
        entry.column: _KINDS[entry.kind]
        for entry in COMMAND_FIELDS.values()
        if entry.kind in _KINDS
    },
    "state": TEXT,
    "reason": TEXT,
    **dict.fromkeys(
        (
            "time",
            "opening",
            "speed",
            "effort",
            "lift_height",
            "gripper_time",
            "gripper_age",
            "perception_ms",
        ),
        NUMBER,
    ),
}
"""Columns of one value. The others have a list with one value per finger or valve."""
_LISTS = {
    "status": TEXT,
    "status_code": TEXT,
    "slip_state": TEXT,
    "shape_kind": TEXT,
    "shape_family": TEXT,
    "touching": FLAG,
    "valve_open": FLAG,
    "images": TEXT,
}
"""Kind of the values in list columns; the default is NUMBER."""
_MANY = {"patches": TABLE, "shape_outline": (NUMBER, NUMBER)}
"""Kind of the entries in columns with a list of variable length per finger."""
_PARTS = {
    **dict.fromkeys(("wrench", "wrench_sd", "wrench_true"), 6),
    **dict.fromkeys(("contact_area_interval", "contact_centroid", "slip_velocity"), 2),
    **dict.fromkeys(("shape_area_interval", "shape_curvatures", "shape_rolling"), 2),
    "shape_sliding": 2,
    "shape_place": 3,
}
"""Number of values per finger; the default is one."""
_LENGTHS = {"object_position_true": 3, "object_quaternion_true": 4}
"""Number of values of a list that is not one per finger. A cycle has all of them, or none."""
_REQUIRED = (
    *("time", "phase", "images", "image_time", "status", "touching", "force_normal"),
    *("opening", "speed", "effort", "lift_height", "valve_open"),
)
"""Columns of every recording; others may be from a later version."""
_VALVES = ("valve_open", "gauge_pressure", "valve_time", "valve_age")
_FINGERS = (
    "image_time",
    "force_normal",
    "force_normal_sd",
    "force_shear",
    "status",
    "status_code",
    "touching",
    "touch_age",
    "wrench",
    "wrench_sd",
    "contact_area",
    "contact_area_interval",
    "contact_centroid",
    "contact_depth",
    "patches",
    "slip_state",
    "stick_ratio",
    "shape_kind",
    "shape_family",
    "shape_area",
    "shape_area_interval",
    "shape_radius",
    "shape_direction",
    "shape_curvatures",
    "shape_place",
    "shape_outline",
    "shape_rolling",
    "shape_sliding",
    "shape_spinning",
    "marker_count",
)
_HEADER = {
    "design": TEXT,
    "sensor": TEXT,
    "object": TEXT,
    "rig": TEXT,
    "command": TEXT,
    "files": TABLE,
    "versions": TABLE,
}
_SCENARIO = {
    **dict.fromkeys(("object", "task", "controller", "rig", "sensor"), (TEXT,)),
    **dict.fromkeys(("effects", "accuracy", "randomization"), (TEXT,)),
    **dict.fromkeys(("seed", "time_limit_s"), (NUMBER,)),
    "contact_shapes": (FLAG,),
}
"""Kinds of the fields of a recorded scenario."""
_NOTES = {
    "start_opening": NUMBER,
    "start_lift_height": NUMBER,
    "unix_time_offset_s": NUMBER,
    "mounting": TABLE,
    "calibration": TABLE,
    "contact_shapes": FLAG,
    "sensors": TABLE,
    "simulated": TABLE,
    "flags": TABLE,
    "break_force_N": NUMBER,
    "fingers": (TEXT,),
}


def kind(value: Any) -> Any:
    """Return the kind of a value: FLAG, NUMBER (also if unknown), TEXT or TABLE.

    For a list it is the tuple of its values' kinds. For anything else it is None.
    """
    if isinstance(value, bool):
        return FLAG
    if value is None or (isinstance(value, (int, float)) and abs(value) <= sys.float_info.max):
        return NUMBER
    if isinstance(value, str):
        return TEXT
    if isinstance(value, Mapping):
        return TABLE
    return tuple(map(kind, value)) if isinstance(value, list) else None


def wrong_column(row: Mapping[str, Any], first: Mapping[str, Any]) -> str | None:
    """Return the first invalid column of a cycle, or None.

    A column is invalid if its kind is wrong, or if its shape differs from the recording's `first`
    cycle.
    """
    time = row.get("time")
    if time is None or kind(time) != NUMBER or time < 0:
        return "time"
    if missing := _missing(row):
        return f"{missing[0]} is missing"
    for key in (key for key in first if key != "kind"):
        found = kind(row.get(key, ...))
        if key in _ONE:
            good = found == _ONE[key]
        elif key in _MANY:
            good = isinstance(found, tuple) and all(
                isinstance(each, tuple) and set(each) <= {_MANY[key]} for each in found
            )
        elif key in _LENGTHS:
            good = found == (NUMBER,) * _LENGTHS[key]
        elif key == "images":
            good = (
                isinstance(found, tuple)
                and _are_names(row[key])
                and len(found) in (0, len(first.get("image_time", ())))
            )
        else:
            kinds = (NUMBER,) * _PARTS[key] if key in _PARTS else _LISTS.get(key, NUMBER)
            good = (
                isinstance(found, tuple) and set(found) <= {kinds} and len(found) == len(first[key])
            )
        if not good:
            return key
    lengths = [[len(row[key]) for key in keys if key in first] for keys in (_VALVES, _FINGERS)]
    return next(
        (
            keys[0]
            for keys, found in zip((_VALVES, _FINGERS), lengths, strict=True)
            if len(set(found)) > 1
        ),
        None,
    )


def _missing(row: Mapping[str, Any]) -> list[str]:
    """Return the columns that a cycle lacks."""
    needed = (*_REQUIRED, *_LENGTHS) if any(key in row for key in _LENGTHS) else _REQUIRED
    return [key for key in needed if key not in row]


def wrong_note(row: Mapping[str, Any]) -> str | None:
    """Return the first invalid field of a header, note or reference line, or None."""
    if row.get("kind") == "reference":
        return _wrong_reference(row)
    for key, expected in (_HEADER if row.get("kind") == "start" else _NOTES).items():
        found = kind(row[key]) if key in row else expected
        if isinstance(expected, tuple):
            good = isinstance(found, tuple) and set(found) <= set(expected)
        else:
            good = found == expected or (row[key] is None and expected != TABLE)
        if not good:
            return key
    return next((key for key, test in _TESTS.items() if key in row and not test(row[key])), None)


def _are_distinct(names: Any) -> bool:
    """Return True for names that differ and are not empty; null is none."""
    return all(names or ()) and len(set(names or ())) == len(names or ())


def _has_texts(tables: Mapping[str, Any]) -> bool:
    """Return True if all values are tables of texts."""
    return _has_tables(tables) and all(
        {kind(value) for value in table.values()} <= {TEXT} for table in tables.values()
    )


def _has_tables(tables: Mapping[str, Any]) -> bool:
    """Return True if all values are tables."""
    return all(kind(table) == TABLE for table in tables.values())


def has_its_checksum(file: Any) -> bool:
    """Return True for a file's name, text and checksum, if text and checksum agree."""
    if kind(file) != TABLE or {kind(file.get(key)) for key in ("name", "sha256", "text")} != {TEXT}:
        return False
    return hashlib.sha256(file["text"].encode()).hexdigest() == file["sha256"]


def _is_scenario(scenario: Any) -> bool:
    """Return True for a table of texts, numbers and flags, and of sensors by finger."""
    if kind(scenario) != TABLE:
        return False
    sensors = scenario.get("sensors", {})
    if kind(sensors) != TABLE or not {kind(sensor) for sensor in sensors.values()} <= {TEXT}:
        return False
    return all(kind(scenario[key]) in kinds for key, kinds in _SCENARIO.items() if key in scenario)


def _is_simulated(how: Mapping[str, Any]) -> bool:
    """Return True for a valid description of a simulation: mesh, step and effects, for report
    pages."""
    effects = how.get("effects", [])
    return (
        kind(how.get("mesh", [])) in {(), (NUMBER, NUMBER)}
        and kind(how.get("timestep_ms")) == NUMBER
        and isinstance(effects, list)
        and all(map(_is_effect, effects))
    )


def _is_flag(value: Any) -> bool:
    """Return True for a reason with times, or for a reason alone as before version 0.2.0."""
    if kind(value) == TEXT:
        return True
    times = {kind(value.get(key)) for key in ("first_s", "last_s", "fraction")} if value else ()
    return kind(value) == TABLE and kind(value.get("reason")) == TEXT and set(times) == {NUMBER}


def _is_effect(row: Any) -> bool:
    return (
        kind(row) == TABLE
        and {kind(row.get(key)) for key in ("effect", "why")} == {TEXT}
        and {kind(row.get(key)) for key in ("on", "built")} == {FLAG}
    )


def _wrong_reference(row: Mapping[str, Any]) -> str | None:
    names, times, pressures = (row.get(key) for key in ("images", "image_time", "gauge_pressure"))
    if not isinstance(row.get("stage"), str):
        return "stage"
    if not isinstance(names, list) or not all(
        isinstance(each, list) and _are_names(each) for each in names
    ):
        return "images"
    if not isinstance(times, list) or any(set(kind(each) or ()) != {NUMBER} for each in times):
        return "image_time"
    if any(names) and [*map(len, times)] != [*map(len, names)]:
        return "image_time"
    if kind(pressures) == (NUMBER,) * len(times):
        return None
    return "gauge_pressure"


def _are_names(values: list[Any]) -> bool:
    """Return True if all values are file paths inside the recording."""
    return all(
        isinstance(value, str)
        and "\0" not in value
        and not PurePosixPath(value).is_absolute()
        and ".." not in PurePosixPath(value).parts
        for value in values
    )


_TESTS: dict[str, Callable[[Any], bool]] = {
    "scenario": _is_scenario,
    "fingers": _are_distinct,
    "simulated": _is_simulated,
    "versions": lambda value: {kind(one) for one in value.values()} <= {TEXT},
    "flags": lambda value: all(map(_is_flag, value.values())),
    "sensors": lambda value: all(map(has_its_checksum, value.values())),
    "files": _has_texts,
    "calibration": _has_tables,
}
"""Tests of the values of a header or a note, by key."""
