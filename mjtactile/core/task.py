"""`Task`: action with an object, disturbances, and success criteria, read from a file.

The seed randomizes the object's mass, friction and strength, and each disturbance, within given
ranges. The robot receives only the `GoalSettings`. The format: docs/reference/task_files.md.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import resources
from mjtactile.core.config_fields import (
    DEGREE,
    MM,
    entries,
    flag,
    from_table,
    number,
    numbers,
    part,
    parts,
    text,
)
from mjtactile.core.field_types import Numbers
from mjtactile.core.toml import Section, read_toml
from mjtactile.core.types import TaskGoal

GRAVITY = 9.81  # gravity, m/s^2
_SPAN = ("low", "high")
KINDS = ("fill", "friction", "shake", "push", "move_support", "pull")
Range = tuple[float, float]


def _range(
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

    def task_goal(self) -> TaskGoal:
        """Return the value that controllers see."""
        return TaskGoal(**{one.name: getattr(self, one.name) for one in fields(self)})


@dataclass(frozen=True)
class ObjectRandomization:
    """Randomization of the object; properties without a range keep the value of its file."""

    mass: Range | None = _range("mass_g", 0.1, 2000, 1e-3, about="mass, uniform in its logarithm")
    friction: Range | None = _range(
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
    breaking: Range | None = _range(
        "break_force_factor", 1.05, 100, about="breaking force over the minimum grip that holds"
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
    mass: Range | None = _range("final_mass_g", 0.1, 2000, 1e-3, of="fill", about="mass at the end")
    friction: Range | None = _range(
        "final_friction", 0.05, 3, of="friction", about="friction coefficient at the end"
    )
    acceleration: Range | None = _range("acceleration_m_s2", 0, 20, of="shake", about="amplitude")
    rate: Range | None = _range("rate_Hz", 0.1, 20, of="shake")
    tilt: Range | None = _range(
        "tilt_deg", 0, 90, DEGREE, of="shake", about="rotation of the gripper"
    )
    impulse: Range | None = _range("impulse_N_s", 0, 1, of="push", about="impulse, from any side")
    height: Range | None = _range(
        "height_mm", -50, 50, MM, of="move_support", about="height of the place above the first one"
    )
    force: Range | None = _range(
        "force_N", 0, 20, of="pull", about="force at the end, from any side"
    )

    def validate(self, section: Section) -> None:
        required = {
            "fill": ("mass",),
            "friction": ("friction",),
            "shake": ("acceleration", "rate"),
            "push": ("impulse",),
            "move_support": ("height",),
            "pull": ("force",),
        }
        _require_order(self, section)
        for name in required[self.kind]:
            if getattr(self, name) is None:
                raise section.fail(entries(Disturbance)[name].key, "is missing")


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

    @property
    def text(self) -> str:
        """Return all criteria as a sentence, for reports."""
        texts = ["held and intact", f"it falls by at most {1e3 * self.max_drop:g} mm at release"]
        if math.isfinite(self.max_tilt):
            texts.append(f"tilted by at most {math.degrees(self.max_tilt):g} deg at the end")
        if math.isfinite(self.release_within):
            texts.append(f"released within {self.release_within:g} s of the pull, not before")
        if math.isfinite(self.max_impact):
            texts.append(f"set down with an impact of at most {self.max_impact:g} N s")
        return "; ".join(texts)


@dataclass(frozen=True)
class SampledDisturbance:
    """Sampled `Disturbance`: SI values by the names of its fields, and a direction."""

    kind: str
    start: float
    duration: float
    values: Mapping[str, float]
    direction: tuple[float, float, float]


@dataclass(frozen=True)
class SampledTask:
    """Values sampled by a seed: mass, kg, friction coefficient, and breaking factor over the
    required force. They are None if the task does not set them; `values` are in the file's units,
    for results."""

    mass: float | None
    friction: float | None
    breaking: float | None
    events: tuple[SampledDisturbance, ...]
    values: Mapping[str, float]

    def pulls(self) -> float:
        """Return the time after the lift at which a pull exceeds 0.3 N, s; NaN without a pull."""
        for event in self.events:
            if event.kind == "pull":
                return event.start + event.duration * min(_PULL / event.values["force"], 1.0)
        return math.nan

    def need(self, mass: float, friction: float, fingers: int) -> float:
        """Compute the required normal force per finger, N, to hold `mass` kg during all
        disturbances (Coulomb).

        Pushes come from any side; from above is the worst case.
        """
        heaviest = max([mass, *(event.values.get("mass", 0.0) for event in self.events)])
        shaken = max((event.values.get("acceleration", 0.0) for event in self.events), default=0.0)
        pushed = max(
            (event.values.get("impulse", 0.0) / event.duration for event in self.events),
            default=0.0,
        )
        lowest = min([friction, *(event.values.get("friction", 9.0) for event in self.events)])
        return (heaviest * (GRAVITY + shaken) + pushed) / (fingers * lowest)


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

    @property
    def is_plain(self) -> bool:
        """True if the task has neither randomization nor disturbances."""
        return not self.disturbances and self.object == ObjectRandomization()

    def sample(self, seed: int, fingers: int) -> SampledTask:
        """Sample the task of a seed for a gripper with `fingers` fingers.

        A value depends only on the seed and on its own name.
        """
        events = []
        values: dict[str, float] = {}
        for number_, disturbance in enumerate(self.disturbances, 1):
            sampled = {
                name: _at(span, _share(seed, f"{number_}.{_STREAMS.get(name, name)}"))
                for name in entries(Disturbance)
                if isinstance(span := getattr(disturbance, name), tuple)
            }
            values |= {
                f"task.{disturbance.kind}{number_}.{_key(Disturbance, name)}": _written(
                    Disturbance, name, value
                )
                for name, value in sampled.items()
            }
            start = sampled.pop("start")
            duration = sampled.pop("duration")
            way = _direction(seed, f"{number_}.direction")
            events.append(SampledDisturbance(disturbance.kind, start, duration, sampled, way))
        grasped = self._sample_object(seed, fingers, tuple(events))
        for name in ("mass", "friction", "breaking"):
            value = getattr(grasped, name)
            if value is not None:
                values[f"task.{_key(ObjectRandomization, name)}"] = _written(
                    ObjectRandomization, name, value
                )
        return SampledTask(grasped.mass, grasped.friction, grasped.breaking, grasped.events, values)

    def _sample_object(
        self, seed: int, fingers: int, events: tuple[SampledDisturbance, ...]
    ) -> SampledTask:
        spans = self.object
        breaking = None if spans.breaking is None else _at(spans.breaking, _share(seed, "breaking"))
        attempt = 0
        while True:
            shares = [_share(seed, f"{name}.{attempt}") for name in ("mass", "friction")]
            mass = None if spans.mass is None else _logarithmic(spans.mass, shares[0])
            friction = None if spans.friction is None else _at(spans.friction, shares[1])
            sampled = SampledTask(mass, friction, breaking, events, {})
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


def _require_order(value: Any, section: Section) -> None:
    """Raise InputError for a range that ends below where it begins."""
    for name, found in entries(type(value)).items():
        span = getattr(value, name)
        if isinstance(span, tuple) and span[0] > span[1]:
            raise section.fail(found.key, "has its lower limit above its upper limit")


def _key(kind: type, name: str) -> str:
    return entries(kind)[name].key


def _written(kind: type, name: str, value: float) -> float:
    """In the file's units, as a result keeps it."""
    found = entries(kind)[name]
    unit = found.unit if isinstance(found, Numbers) else 1.0
    return float(f"{value / unit:.6g}")


def _share(seed: int, name: str) -> float:
    return float(np.random.default_rng([seed, zlib.crc32(f"task.{name}".encode())]).random())


def _at(span: Range, share: float) -> float:
    return span[0] + share * (span[1] - span[0])


def _logarithmic(span: Range, share: float) -> float:
    return float(span[0] * (span[1] / span[0]) ** share)


def _direction(seed: int, name: str) -> tuple[float, float, float]:
    """A unit vector, any as likely as another."""
    rng = np.random.default_rng([seed, zlib.crc32(f"task.{name}".encode())])
    way = rng.standard_normal(3)
    x, y, z = (float(value) for value in way / np.linalg.norm(way))
    return x, y, z
