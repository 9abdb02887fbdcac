"""`Task`: action with an object, disturbances, and success criteria, read from a file.

The seed randomizes the object's mass, friction and strength, and each disturbance, within given
ranges. The robot receives only the `GoalSettings`. The format: docs/reference/task_files.md.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import resources
from mjtactile.core.config_fields import (
    SectionEntry,
    entries,
    entry,
    from_table,
    number,
    part,
    parts,
    text,
)
from mjtactile.core.field_types import Numbers
from mjtactile.core.gripper_path import GripperPath, Segment
from mjtactile.core.task_sections import (
    Disturbance,
    GoalSettings,
    ObjectRandomization,
    Range,
    SuccessCriteria,
    Waypoint,
)
from mjtactile.core.toml import Section, read_toml

GRAVITY = 9.81  # gravity, m/s^2


@dataclass(frozen=True)
class SampledDisturbance:
    """Sampled `Disturbance`: SI values by the names of its fields, and a direction.

    `finger` is the contact side, from 1 (None: all).
    """

    kind: str
    start: float
    duration: float
    values: Mapping[str, float]
    direction: tuple[float, float, float]
    finger: int | None = None


@dataclass(frozen=True)
class SampledTask:
    """Values sampled by a seed: mass, kg, friction coefficient, and breaking factor over the
    required force. They are None if the task does not set them. `values` are in the file's units,
    for results. `liquid` is the fill height over the object's height. `path` is that of the gripper
    (None: no motion)."""

    mass: float | None
    friction: float | None
    breaking: float | None
    events: tuple[SampledDisturbance, ...]
    values: Mapping[str, float]
    liquid: float | None = None
    path: GripperPath | None = None

    def pulls(self) -> float:
        """Return the time after the lift at which a pull exceeds 0.3 N, s; NaN without a pull."""
        for event in self.events:
            if event.kind == "pull":
                return event.start + event.duration * min(_PULL / event.values["force"], 1.0)
        return math.nan

    def stacked(self) -> SampledDisturbance | None:
        """Return the event in which a second object is placed on the held one. None: there is
        none."""
        return next((event for event in self.events if event.kind == "stack"), None)

    def need(self, mass: float, friction: float, fingers: int) -> float:
        """Compute the required normal force per finger, N, to hold `mass` kg during all
        disturbances (Coulomb).

        Pushes come from any side; from above is the worst case.
        """
        heaviest = max([mass, *(event.values.get("mass", 0.0) for event in self.events)])
        heaviest += sum(event.values.get("added_mass", 0.0) for event in self.events)
        shaken = max((event.values.get("acceleration", 0.0) for event in self.events), default=0.0)
        pushed = max(
            (event.values.get("impulse", 0.0) / event.duration for event in self.events),
            default=0.0,
        )
        lowest = min([friction, *(event.values.get("friction", 9.0) for event in self.events)])
        gravity = GRAVITY if self.path is None else self.path.max_load(GRAVITY)
        return (heaviest * (gravity + shaken) + pushed) / (fingers * lowest)


@dataclass(frozen=True)
class Task:
    """A task file."""

    name: str
    disturbances: tuple[Disturbance, ...] = parts("disturbance", Disturbance, 0, 20)
    about: str = text("about", default="")
    version: str = text("version", default="")
    time_limit: float = number("time_limit_s", 0.1, 86400, default=60.0)
    goal: GoalSettings = part("goal", GoalSettings, default=GoalSettings())
    object: ObjectRandomization = part("object", ObjectRandomization, default=ObjectRandomization())
    success: SuccessCriteria = part("success", SuccessCriteria, default=SuccessCriteria())
    waypoints: tuple[Waypoint, ...] = entry(
        SectionEntry(key="waypoint", kind=Waypoint, count=(0, 20)), ()
    )

    def validate(self, section: Section) -> None:
        """Raise InputError for a path that ends after the hold, or criteria without their cause."""
        slowest = self._path(lambda name, span: span[0] if "speed" in name else span[1])
        if slowest is not None and slowest.end > self.goal.hold_time:
            text = f"{self.goal.hold_time:g} s is less than the duration of the path, up to "
            raise section.fail("goal.hold_time_s", f"{text}{slowest.end:.1f} s")
        kinds = [disturbance.kind for disturbance in self.disturbances]
        if kinds.count("stack") > 1:
            raise section.fail("disturbance", "has more than one of kind stack")
        if self.object.liquid is not None and "fill" in kinds:
            text = "is not possible with a disturbance of kind fill"
            raise section.fail("object.liquid_fill_percent", text)
        if self.success.place_within < math.inf and not self.waypoints:
            raise section.fail("success.place_within_mm", "requires a waypoint, which is missing")
        if self.success.stacked and "stack" not in kinds:
            raise section.fail("success.stacked", "requires a disturbance of kind stack")

    @property
    def is_plain(self) -> bool:
        """True if the task has neither randomization nor disturbances."""
        changes = self.disturbances or self.waypoints
        return not changes and self.object == ObjectRandomization()

    def sample(self, seed: int, fingers: int) -> SampledTask:
        """Sample the task of a seed for a gripper with `fingers` fingers.

        A value depends only on the seed and on its own name.
        """
        events = []
        values: dict[str, float] = {}
        for number_, disturbance in enumerate(self.disturbances, 1):
            sampled = {
                name: _linear(span, _fraction(seed, f"{number_}.{_STREAMS.get(name, name)}"))
                for name, span in disturbance.sampled_ranges().items()
            }
            values |= {
                f"task.{disturbance.kind}{number_}.{_key(Disturbance, name)}": _written(
                    Disturbance, name, value
                )
                for name, value in sampled.items()
            }
            start = sampled.pop("start")
            duration = sampled.pop("duration")
            way = _way(disturbance, seed, f"{number_}.direction")
            kind, finger = disturbance.kind, disturbance.finger
            events.append(SampledDisturbance(kind, start, duration, sampled, way, finger))
        grasped = self._sample_object(seed, fingers, tuple(events))
        for name in ("mass", "friction", "breaking", "liquid"):
            value = getattr(grasped, name)
            if value is not None:
                values[f"task.{_key(ObjectRandomization, name)}"] = _written(
                    ObjectRandomization, name, value
                )

        def at(name: str, span: Range) -> float:
            value = _linear(span, _fraction(seed, name))
            number_, _, field = name.removeprefix("waypoint").partition(".")
            key = f"task.waypoint{number_}.{_key(Waypoint, field)}"
            values[key] = _written(Waypoint, field, value)
            return value

        return replace(grasped, values=values, path=self._path(at))

    def _path(self, at: Callable[[str, Range], float]) -> GripperPath | None:
        """Return the gripper's path. `at` chooses the value of a name from its range."""
        segments = []
        for number_, waypoint in enumerate(self.waypoints, 1):
            found: dict[str, Any] = {
                name: None if span is None else at(f"waypoint{number_}.{name}", span)
                for name, span in vars(waypoint).items()
            }
            segments.append(Segment(**found))
        return GripperPath.of(segments) if segments else None

    def _sample_object(
        self, seed: int, fingers: int, events: tuple[SampledDisturbance, ...]
    ) -> SampledTask:
        spans = self.object
        breaking = (
            None if spans.breaking is None else _linear(spans.breaking, _fraction(seed, "breaking"))
        )
        liquid = None if spans.liquid is None else _linear(spans.liquid, _fraction(seed, "liquid"))
        path = self._path(lambda name, span: _linear(span, _fraction(seed, name)))
        attempt = 0
        while True:
            fractions = [_fraction(seed, f"{name}.{attempt}") for name in ("mass", "friction")]
            mass = None if spans.mass is None else _logarithmic(spans.mass, fractions[0])
            friction = None if spans.friction is None else _linear(spans.friction, fractions[1])
            sampled = SampledTask(mass, friction, breaking, events, {}, liquid, path)
            attempt += 1
            if mass is None or friction is None or attempt > _ATTEMPTS:
                return sampled
            if sampled.need(mass, friction, fingers) <= spans.need_max:
                return sampled


# names of random streams; the seed of a stream is a hash of its name
_STREAMS = {"start": "begin", "duration": "last"}
_PULL = 0.3  # threshold of a pull, N
# maximum number of samples; then the last one is used, although it exceeds the limit
_ATTEMPTS = 1000


def load_task(name_or_path: str | Path) -> Task:
    """Read a task.

    Args:
        name_or_path: A shipped name, or a user's TOML file.

    Returns:
        The task; its name is the file's.

    Raises:
        InputError: Names file, field, value and valid choices of a missing or wrong entry.
    """
    path = resources.find(name_or_path, "models/tasks", ".toml")
    return from_table(Task, read_toml(path), str(path), name=path.stem)


def _key(kind: type, name: str) -> str:
    return entries(kind)[name].key


def _written(kind: type, name: str, value: float) -> float:
    """Convert a value to the file's unit, rounded as in results."""
    found = entries(kind)[name]
    unit = found.unit if isinstance(found, Numbers) else 1.0
    return float(f"{value / unit:.6g}")


def _fraction(seed: int, name: str) -> float:
    return float(np.random.default_rng([seed, zlib.crc32(f"task.{name}".encode())]).random())


def _linear(span: Range, fraction: float) -> float:
    return span[0] + fraction * (span[1] - span[0])


def _logarithmic(span: Range, fraction: float) -> float:
    return float(span[0] * (span[1] / span[0]) ** fraction)


def _way(disturbance: Disturbance, seed: int, name: str) -> tuple[float, float, float]:
    """Return the unit vector of a disturbance. A sampled pull is not from below."""
    if disturbance.direction is not None:
        x, y, z = disturbance.direction
        length = math.hypot(x, y, z)
        return x / length, y / length, z / length
    x, y, z = _direction(seed, name)
    return x, y, abs(z) if disturbance.kind == "pull" else z


def _direction(seed: int, name: str) -> tuple[float, float, float]:
    """Sample a unit vector (3,) uniformly on the sphere."""
    rng = np.random.default_rng([seed, zlib.crc32(f"task.{name}".encode())])
    direction = rng.standard_normal(3)
    x, y, z = (float(value) for value in direction / np.linalg.norm(direction))
    return x, y, z
