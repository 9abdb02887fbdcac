"""Sections of a task file: goal, object, disturbances, waypoints and success criteria.

The format: docs/reference/task_files.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from mjtactile.core.config_fields import (
    DEGREE,
    MM,
    PERCENT,
    entries,
    flag,
    integer,
    number,
    numbers,
    text,
)
from mjtactile.core.toml import Section
from mjtactile.core.types import TaskGoal

_SPAN = ("low", "high")
_AXES = ("x", "y", "z")
KINDS = ("fill", "friction", "shake", "push", "move_support", "pull", "stack")
_DIRECTED = ("shake", "push", "pull")
Range = tuple[float, float]


def sampled_range(
    key: str, low: float, high: float, unit: float = 1.0, *, of: str = "", about: str = ""
) -> Any:
    """Return a field that is [low, high], sampled by the seed. It may apply to one kind of
    `Disturbance` only."""
    only_if = ("kind", (of,)) if of else None
    return numbers(key, _SPAN, low, high, unit, default=None, only_if=only_if, about=about)


@dataclass(frozen=True)
class GoalSettings:
    """Goal of the task, as given to the robot."""

    lift_height: float = number(
        "lift_height_mm", 5, 150, MM, default=0.040, about="height of the lift"
    )
    hold_time: float = number(
        "hold_time_s", 0.1, 600, default=2.0, about="duration of the hold at that height"
    )
    place_height: float = number(
        "place_height_mm", 0, 150, MM, default=0.0, about="height of the place to set down on"
    )
    handover: bool = flag("handover", default=False, about="true if the object will be taken")
    push: float = number("push_N", 0, 20, default=0.0, about="maximum announced push")
    acceleration: float = number(
        "acceleration_m_s2",
        0,
        20,
        default=0.0,
        about="maximum announced acceleration of the gripper",
    )

    def task_goal(self) -> TaskGoal:
        """Return the value that controllers see."""
        return TaskGoal(**{entry.name: getattr(self, entry.name) for entry in fields(self)})


@dataclass(frozen=True)
class ObjectRandomization:
    """Randomization of the object. Properties without a range keep the value of its file."""

    mass: Range | None = sampled_range(
        "mass_g", 0.1, 2000, 1e-3, about="mass, uniform in its logarithm"
    )
    friction: Range | None = sampled_range(
        "friction", 0.05, 3, about="friction coefficient with the membranes"
    )
    need_max: float = number(
        "required_grip_max_N",
        0.01,
        20,
        default=math.inf,
        about="maximum required force per finger; mass and friction above it are sampled again",
    )
    breaking_min: float = number(
        "break_force_min_N", 0, 100, default=0.0, about="lower limit of the breaking force"
    )
    breaking: Range | None = sampled_range(
        "break_force_factor", 1.05, 100, about="breaking force over the minimum grip that holds"
    )

    liquid: Range | None = sampled_range(
        "liquid_fill_percent", 5, 95, PERCENT, about="fill height of a liquid over the height"
    )

    def validate(self, section: Section) -> None:
        _require_order(self, section)
        if self.breaking is not None and self.friction is None:
            raise section.fail("break_force_factor", "requires friction, which is missing")


@dataclass(frozen=True)
class Disturbance:
    """One disturbance. It starts `start` s after the lift is complete and takes
    `duration` s."""

    kind: str = text("kind", KINDS)
    start: Range = numbers("start_s", _SPAN, 0, 600, about="start time after the lift")
    duration: Range = numbers("duration_s", _SPAN, 0.001, 600)
    mass: Range | None = sampled_range(
        "final_mass_g", 0.1, 2000, 1e-3, of="fill", about="mass at the end"
    )
    friction: Range | None = sampled_range(
        "final_friction", 0.05, 3, of="friction", about="friction coefficient at the end"
    )
    acceleration: Range | None = sampled_range(
        "acceleration_m_s2", 0, 20, of="shake", about="amplitude"
    )
    rate: Range | None = sampled_range("rate_Hz", 0.1, 20, of="shake")
    tilt: Range | None = sampled_range(
        "tilt_deg", 0, 90, DEGREE, of="shake", about="rotation of the gripper"
    )
    impulse: Range | None = sampled_range("impulse_N_s", 0, 1, of="push", about="impulse")
    height: Range | None = sampled_range(
        "height_mm", -50, 50, MM, of="move_support", about="height of the place above the first one"
    )
    force: Range | None = sampled_range("force_N", 0, 20, of="pull", about="force at the end")
    added_mass: Range | None = sampled_range(
        "object_mass_g", 0.1, 2000, 1e-3, of="stack", about="mass of the second object"
    )
    size: Range | None = sampled_range(
        "object_size_mm", 2, 200, MM, of="stack", about="edge length of the second object, a cube"
    )
    direction: tuple[float, float, float] | None = numbers(
        "direction",
        _AXES,
        -1,
        1,
        default=None,
        only_if=("kind", _DIRECTED),
        about="direction of the force or the motion; default: sampled",
    )
    finger: int | None = integer(
        "finger",
        1,
        8,
        default=None,
        only_if=("kind", ("friction",)),
        about="contact side, counted as in the rig file; default: all",
    )

    def validate(self, section: Section) -> None:
        required = {
            "fill": ("mass",),
            "friction": ("friction",),
            "shake": ("acceleration", "rate"),
            "push": ("impulse",),
            "move_support": ("height",),
            "pull": ("force",),
            "stack": ("added_mass", "size"),
        }
        _require_order(self, section)
        for name in required[self.kind]:
            if getattr(self, name) is None:
                raise section.fail(entries(Disturbance)[name].key, "is missing")
        if self.direction is not None and not any(self.direction):
            raise section.fail("direction", "[0, 0, 0] is not a direction")

    def sampled_ranges(self) -> dict[str, Range]:
        """Return the ranges from which a seed samples, by field."""
        found = {name: getattr(self, name) for name in entries(Disturbance)}
        return {name: value for name, value in found.items() if _is_range(value)}


@dataclass(frozen=True)
class Waypoint:
    """Position on the path of the gripper, relative to that after the lift.

    x is the closing direction of the first finger. z is up. The gripper stops at each waypoint. A
    missing coordinate keeps its value.
    """

    x: Range | None = sampled_range("x_mm", -1000, 1000, MM, about="along the closing direction")
    y: Range | None = sampled_range("y_mm", -1000, 1000, MM, about="across it")
    z: Range | None = sampled_range("z_mm", -150, 1000, MM, about="height")
    tilt: Range | None = sampled_range(
        "tilt_deg", -120, 120, DEGREE, about="rotation about the closing direction"
    )
    speed: Range = numbers(
        "speed_mm_s", _SPAN, 1, 2000, MM, default=(0.1, 0.1), about="mean speed on the way to it"
    )
    tilt_speed: Range = numbers(
        "tilt_speed_deg_s", _SPAN, 1, 720, DEGREE, default=(0.5, 0.5), about="mean rotation speed"
    )
    wait: Range = numbers(
        "wait_s", _SPAN, 0, 60, default=(0.0, 0.0), about="waiting time before the motion"
    )

    def validate(self, section: Section) -> None:
        _require_order(self, section)
        if self.x is self.y is self.z is self.tilt is None:
            raise section.fail("x_mm", "is missing, as are y_mm, z_mm and tilt_deg: no motion")


@dataclass(frozen=True)
class SuccessCriteria:
    """Criteria of success, in addition to an object that is held and intact."""

    max_tilt: float = number(
        "tilt_max_deg", 0, 180, DEGREE, default=math.inf, about="maximum tilt at the end, standing"
    )
    release_within: float = number(
        "release_within_s", 0, 60, default=math.inf, about="time limit after a pull, not before it"
    )
    max_drop: float = number(
        "drop_max_mm", 0.1, 200, MM, default=0.015, about="maximum fall at release"
    )
    max_impact: float = number(
        "impact_max_N_s", 0, 10, default=math.inf, about="maximum impact at set-down"
    )

    place_within: float = number(
        "place_within_mm",
        0.1,
        500,
        MM,
        default=math.inf,
        about="maximum horizontal distance at the end from the last waypoint",
    )
    stacked: bool = flag(
        "stacked", default=False, about="true if the second object must stay on the first"
    )

    @property
    def text(self) -> str:
        """Sentence with all criteria, for reports."""
        texts = ["held and intact", f"it falls by at most {1e3 * self.max_drop:g} mm at release"]
        if math.isfinite(self.max_tilt):
            texts.append(f"tilted by at most {math.degrees(self.max_tilt):g} deg at the end")
        if math.isfinite(self.release_within):
            texts.append(f"released within {self.release_within:g} s of the pull, not before")
        if math.isfinite(self.max_impact):
            texts.append(f"set down with an impact of at most {self.max_impact:g} N s")
        if math.isfinite(self.place_within):
            texts.append(f"set down within {1e3 * self.place_within:g} mm of its place")
        if self.stacked:
            texts.append("the second object stays on it while it is held")
        return "; ".join(texts)


def _require_order(value: Any, section: Section) -> None:
    """Raise InputError for a range whose maximum is below its minimum."""
    for name, found in entries(type(value)).items():
        span = getattr(value, name)
        if _is_range(span) and span[0] > span[1]:
            raise section.fail(found.key, "has its lower limit above its upper limit")


def _is_range(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == len(_SPAN)
