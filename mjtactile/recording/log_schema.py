"""Columns of a recording's log: `SENSED` has one entry per key, with its meaning and source.

docs/reference/recording_format.md contains the same table, and a test compares the two. SI units;
columns with one value per finger are lists. An unknown value is NaN in memory and null in the file,
with the shape of a known one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np

from mjtactile.core.types import (
    COMMAND_FIELDS,
    Array,
    Command,
    Contact,
    GripperState,
    Image,
    Touch,
    ValveState,
)
from mjtactile.core.types.command import CommandField

_NAN2 = [np.nan] * 2
_NAN3 = [np.nan] * 3
_NAN6 = [np.nan] * 6
Column: TypeAlias = "tuple[str, str, Callable[[CycleLike], Any]]"
"""Unit and meaning of a column, and the function that reads it from a cycle."""
_BORDER = 24  # maximum number of points of an outline


class Seen(Protocol):
    """Part of a control cycle that displays use."""

    @property
    def time(self) -> float: ...
    @property
    def images(self) -> tuple[Image, ...]: ...
    @property
    def touch(self) -> tuple[Touch, ...]: ...


class CycleLike(Seen, Protocol):
    """Recordable data of one control cycle, as in `mjtactile.runtime.control_loop.Cycle`."""

    @property
    def gripper(self) -> GripperState: ...
    @property
    def valves(self) -> tuple[ValveState, ...]: ...
    @property
    def sent(self) -> Command: ...
    @property
    def perception_ms(self) -> float: ...


def _shear(touch: Touch) -> float:
    return np.nan if touch.traction is None else float(np.hypot(*touch.traction.wrench[:2]))


def _patch(patch: Contact) -> dict[str, Any]:
    return {
        "area": patch.area,
        "centroid": patch.centroid,
        "depth": patch.depth,
        "force": patch.force,
        "semi_axes": patch.semi_axes,
        "angle": patch.angle,
    }


def _outline(touch: Touch) -> Array:
    """Return up to 24 points of the contact outline, m, rounded to whole micrometers."""
    if touch.shape is None:
        return np.zeros((0, 2))
    border = touch.shape.outline
    return np.round(border[:: -(-len(border) // _BORDER) or 1], 6)


def _valves(name: str) -> Callable[[CycleLike], Any]:
    return lambda cycle: [getattr(valve, name) for valve in cycle.valves]


def _of_command(name: str, entry: CommandField) -> Column:
    """Return unit, meaning and reader of the column of one field of `Command`."""
    meaning = f"command: {entry.about}"
    if entry.none:
        meaning = f"{meaning}; null: {entry.none}"
    return (
        entry.unit,
        meaning,
        lambda cycle: entry.write(getattr(cycle.sent, name), len(cycle.touch)),
    )


_COMMANDED = {entry.column: _of_command(name, entry) for name, entry in COMMAND_FIELDS.items()}


def _of_touch(value: Callable[[Touch], Any]) -> Callable[[CycleLike], Any]:
    return lambda cycle: [value(touch) for touch in cycle.touch]


def _of_part(path: str, unknown: Any, unit: str, meaning: str) -> Column:
    """Return the column of one attribute of a part of each touch, such as "slip.state".

    The value is `unknown` if the touch has no such part.
    """
    *parts, name = path.split(".")

    def value(touch: Touch) -> Any:
        found: Any = touch
        for step in parts:
            found = getattr(found, step)
            if found is None:
                return unknown
        return getattr(found, name)

    return unit, meaning, _of_touch(value)


SENSED: Mapping[str, Column] = {
    "time": ("s", "rig's clock", lambda c: c.time),
    "phase": _COMMANDED["phase"],
    "image_time": ("s", "capture time of the image", lambda c: [image.time for image in c.images]),
    "force_normal": (
        "N",
        "normal force, positive when pressing",
        _of_touch(lambda t: t.force_normal),
    ),
    "force_normal_sd": (
        "N",
        "standard deviation of `force_normal`",
        _of_touch(lambda t: t.force_normal_sd),
    ),
    "force_shear": ("N", "magnitude of the shear force", _of_touch(_shear)),
    "wrench": _of_part(
        "traction.wrench",
        _NAN6,
        "N, N m",
        "force on the membrane (x, y, z) and torque about the frame center, frame S; z is "
        "negative when pressing",
    ),
    "wrench_sd": (
        "N, N m",
        "standard deviations of `wrench`",
        _of_touch(
            lambda t: _NAN6 if t.traction is None else np.sqrt(np.diag(t.traction.wrench_cov))
        ),
    ),
    "touching": ("", "contact with the membrane", _of_touch(lambda t: t.touching)),
    "status": ("", '"ok", or the reason why the force is unknown', _of_touch(lambda t: t.status)),
    "status_code": ("", "one of `StatusCode`", _of_touch(lambda t: t.status.code)),
    "touch_age": ("s", "age of the image at the end of perception", _of_touch(lambda t: t.age)),
    "contact_area": _of_part(
        "contact.area", np.nan, "m^2", "total contact area; 0 without contact"
    ),
    "contact_area_interval": _of_part(
        "contact.area_interval", _NAN2, "m^2", "68 % interval of the contact area"
    ),
    "contact_centroid": _of_part(
        "contact.centroid", _NAN2, "m", "contact centroid (x, y), frame S"
    ),
    "contact_depth": _of_part("contact.depth", np.nan, "m", "maximum indentation depth"),
    "patches": (
        "m^2, m, N",
        "contact patches, strongest first: `area`, `centroid`, `depth`, `force`, `semi_axes` and "
        "`angle` (rad from x) of the ellipse",
        _of_touch(lambda t: [_patch(p) for p in t.patches]),
    ),
    "slip_state": _of_part(
        "slip.state", "unknown", "", "none, sticking, incipient, slipping or unknown"
    ),
    "slip_velocity": _of_part(
        "slip.velocity", _NAN2, "m/s", "of the object relative to the membrane (x, y), frame S"
    ),
    "slip_distance": _of_part("slip.distance", np.nan, "m", "since the start of the contact"),
    "stick_ratio": _of_part(
        "slip.stick_ratio", np.nan, "", "fraction of the contact that still sticks"
    ),
    "shape_kind": _of_part(
        "shape.kind",
        "none",
        "",
        "smooth, flat, edge, point, multiple, unknown; none without images",
    ),
    "shape_family": _of_part(
        "shape.family", "none", "", "ball, cylinder, smooth, disc, block; several joined by +"
    ),
    "shape_area": _of_part("shape.area", np.nan, "m^2", "membrane area in contact"),
    "shape_area_interval": _of_part(
        "shape.area_interval", _NAN2, "m^2", "68 % interval of `shape_area`"
    ),
    "shape_radius": _of_part("shape.radius", np.nan, "m", "of a ball, a lying cylinder or a disc"),
    "shape_direction": _of_part(
        "shape.direction", np.nan, "rad", "angle from x of an edge or the smaller curvature"
    ),
    "shape_curvatures": _of_part(
        "shape.curvatures", _NAN2, "1/m", "of a smooth shape, the larger first"
    ),
    "shape_place": _of_part(
        "shape.p_SO", _NAN3, "m", "point nearest to the sensor (x, y, z), frame S"
    ),
    "shape_outline": ("m", "up to 24 points (x, y), frame S", _of_touch(_outline)),
    "shape_rolling": _of_part(
        "shape.motion.rolling",
        _NAN2,
        "rad/s",
        "rotation rate about x and y; of a round shape as implied without slip",
    ),
    "shape_sliding": _of_part(
        "shape.motion.sliding", _NAN2, "m/s", "velocity relative to the rubber (x, y), frame S"
    ),
    "shape_spinning": _of_part(
        "shape.motion.spinning", np.nan, "rad/s", "rotation rate relative to the rubber about z"
    ),
    "marker_count": (
        "",
        "markers found",
        _of_touch(lambda t: 0 if t.markers is None else len(t.markers)),
    ),
    "opening": ("m", "reported by the gripper", lambda c: c.gripper.opening),
    "speed": ("m/s", "of the opening", lambda c: c.gripper.speed),
    "effort": ("N", "force at a jaw, estimated by the servo", lambda c: c.gripper.effort),
    "lift_height": ("m", "of the gripper above its start", lambda c: c.gripper.lift_height),
    "gripper_time": ("s", "measurement time", lambda c: c.gripper.time),
    "gripper_age": ("s", "age when delivered", lambda c: c.gripper.age),
    "valve_open": ("", "true for each open valve", _valves("is_open")),
    "gauge_pressure": (
        "Pa",
        "of each chamber; null without a pressure sensor",
        _valves("gauge_pressure"),
    ),
    "valve_time": ("s", "measurement time", _valves("time")),
    "valve_age": ("s", "age when delivered", _valves("age")),
    **_COMMANDED,
    "perception_ms": ("ms", "wall time of the sensing pipeline", lambda c: c.perception_ms),
    "state": ("", "state of the supervisor", lambda c: getattr(c, "state", "running")),
    "reason": ("", "if the state is not running", lambda c: getattr(c, "reason", "")),
}
"""Columns by name."""

TRUE: Mapping[str, tuple[str, str]] = {
    "force_normal_true": ("N", "normal force on each membrane"),
    "wrench_true": ("N, N m", "contact wrench on each membrane, as `wrench`"),
    "marker_error_true": ("m", "mean distance of the detected markers from their true positions"),
    "object_position_true": ("m", "position of the object (x, y, z), frame W"),
    "object_quaternion_true": ("", "rotation of the object (w, x, y, z), frame W"),
}
"""Unit and meaning of the columns of a simulation, from `mjtactile.runtime.grasp_scoring`."""

KEYS = ("images", *SENSED, *TRUE)


def make_row(cycle: CycleLike, names: Sequence[str], truth: Mapping[str, Any]) -> dict[str, Any]:
    """Return one line of the log. `names` are the files of the cycle's images."""
    return {
        "kind": "cycle",
        "images": list(names),
        **{key: value(cycle) for key, (_, _, value) in SENSED.items()},
        **truth,
    }
