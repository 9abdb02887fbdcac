"""Domain randomization: a file of ranges and distributions, and the values sampled for a seed.

    rig = build_sim_rig(Scenario(object="egg", seed=3, randomization="default"))

The simulated world uses the sampled values. Sensing and control keep those of the sensor file and
the rig file. A value depends only on the seed and on its own name. An additional line in a file
therefore does not change the other values. For the format see docs/how-to/evaluate.md.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from mjtactile.core import resources
from mjtactile.core.config_fields import (
    DEGREE,
    MM,
    MS,
    PERCENT,
    entries,
    from_table,
    number,
    numbers,
)
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.field_types import Number, Numbers
from mjtactile.core.renamed import old_key
from mjtactile.core.toml import Section, read_toml
from mjtactile.rig.as_built_sensor import AsBuiltSensor
from mjtactile.rig.camera_faults import CameraFaults
from mjtactile.rig.simulated import SimRigFile

MISSING = "missing_markers"
NONE = "none"
CAMERA = "camera"
_CUT = 3.0
"""Truncation of normal distributions, in standard deviations."""
_MISSING_MAX = 40


@dataclass(frozen=True)
class ObjectChange:
    """Deviation of the object from its file; None: the pose that the seed gives."""

    size: float = number(
        "size_percent", -50, 100, PERCENT, default=0.0, about="increase of the size, with the mass"
    )
    mass: float = number(
        "mass_percent", -90, 900, PERCENT, default=0.0, about="more mass at constant size"
    )
    friction: float = number(
        "friction_percent",
        -95,
        400,
        PERCENT,
        default=0.0,
        about="increase of the friction with the membranes, the table and its stand",
    )
    stiffness: float = number(
        "stiffness_percent", -90, 900, PERCENT, default=0.0, about="stiffer springs or elements"
    )
    breaking: float = number(
        "breaking_percent", -90, 900, PERCENT, default=0.0, about="increase of the breaking force"
    )
    place: tuple[float, float] | None = numbers(
        "place_mm", "xy", -30, 30, MM, default=None, about="pose on the table"
    )
    yaw: float | None = number(
        "yaw_deg", -180, 180, DEGREE, default=None, about="pose on the table"
    )


UNCHANGED = ObjectChange()


@dataclass(frozen=True)
class RigChange:
    """Deviation of the gripper from its file."""

    delay: float = number(
        "delay_ms", 0, 1000, MS, default=0.0, about="delay until a command takes effect"
    )
    jitter: float = number(
        "jitter_ms", 0, 1000, MS, default=0.0, about="additional delay, uniform from 0 to this"
    )
    backlash: float = number(
        "backlash_mm", 0, 10, MM, default=0.0, about="gear backlash of the opening"
    )
    speed: float = number("speed_percent", -90, 400, PERCENT, default=0.0, about="faster")
    force_noise: float = number(
        "force_noise_N", 0, 10, default=0.0, about="sd of the reported closing force"
    )


FAULTLESS = RigChange()


@dataclass(frozen=True)
class SampledWorld:
    """Sampled world of one grasp.

    `values` are the samples by name in the file's units, as stored with a result.
    """

    object: ObjectChange = UNCHANGED
    rig: RigChange = FAULTLESS
    as_built: tuple[AsBuiltSensor, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)

    def as_built_sensor(self, finger: str) -> AsBuiltSensor:
        """Return the as-built sensor of a finger; without an entry it equals the sensor file."""
        return next(
            (sensor for sensor in self.as_built if sensor.finger == finger), AsBuiltSensor(finger)
        )


def _entries_of(group: str) -> tuple[Number, ...]:
    """Return the fields of an as-built sensor that belong to a section of the file."""
    found = [entry for entry in entries(AsBuiltSensor).values() if entry.group == group]
    # for missing markers, their number is sampled first, then the markers
    count = Number(key=MISSING, low=0, high=_MISSING_MAX)
    return tuple(count if entry.key == MISSING else entry for entry in found)


SECTIONS: dict[str, tuple[Number, ...]] = {
    "object": tuple(entries(ObjectChange).values()),
    "sensor": _entries_of("sensor"),
    "gas": _entries_of("gas"),
    CAMERA: tuple(entries(CameraFaults).values()),
    "rig": tuple(entries(RigChange).values()),
}
"""Parameters that can be randomized. Those of `sensor`, `gas` and `camera` are sampled per
finger."""
_OF_FINGERS = ("sensor", "gas", CAMERA)


@dataclass(frozen=True)
class Spread:
    """Distribution of a parameter.

    It is uniform from `low` to `high`, or normal with `mean` and `sd` (truncated at three). It may
    also be one of `choices` with equal probability.
    """

    low: float = 0.0
    high: float = 0.0
    mean: float | None = None
    sd: float = 0.0
    choices: tuple[float, ...] = ()

    def at(self, fraction: float) -> float:
        """Return the quantile at `fraction`, 0 to 1."""
        if self.choices:
            return self.choices[min(int(fraction * len(self.choices)), len(self.choices) - 1)]
        if self.mean is None:
            return self.low + fraction * (self.high - self.low)
        normal = NormalDist()
        tail = normal.cdf(-_CUT)
        return self.mean + self.sd * normal.inv_cdf(tail + fraction * (1 - 2 * tail))


@dataclass(frozen=True)
class Randomization:
    """A file of ranges: of each name ("object.size_percent") its entry and its distribution."""

    name: str
    spreads: Mapping[str, tuple[Number, Spread]]
    path: Path | None = None

    def sample(self, seed: int, *, fingers: Sequence[str], markers: int) -> SampledWorld:
        """Return the randomized world of `seed` for these fingers, with `markers` on each.

        The result does not depend on other randomized values or runs.
        """
        values: dict[str, Any] = {}
        for name, (entry, spread) in self.spreads.items():
            section, _, key = name.partition(".")
            owners = fingers if section in _OF_FINGERS else [section]
            # a section of the finger's own, as in a rig file
            inner = f"{CAMERA}." if section == CAMERA else ""
            key_path, stream = f"{inner}{key}", f"{inner}{old_key(key)}"
            values |= {
                f"{owner}.{key_path}": _sample(f"{owner}.{stream}", entry, spread, seed, markers)
                for owner in owners
            }
        own: dict[str, dict[str, Any]] = {owner: {} for owner in ("object", "rig", *fingers)}
        for name, value in values.items():
            owner, *inner, key = name.split(".")
            table = own[owner]
            for section in inner:
                table = table.setdefault(section, {})
            table[key] = value
        return SampledWorld(
            from_table(ObjectChange, own["object"], self.name),
            from_table(RigChange, own["rig"], self.name),
            tuple(
                from_table(AsBuiltSensor, own[finger], self.name, finger=finger)
                for finger in fingers
            ),
            values,
        )


def load_variation(name_or_path: str | Path) -> Randomization:
    """Read a randomization by shipped name or from a TOML file; "none" disables randomization.

    Raises InputError that names file, field and valid choices. Causes are an unknown name, a value
    out of range or an invalid distribution.
    """
    if name_or_path == NONE:
        return Randomization(NONE, {})
    text = str(name_or_path)
    shipped = resources.names("models/randomization", ".toml")
    if not text.endswith(".toml") and "/" not in text and text not in shipped:
        message = f"unknown variation {text!r}"
        raise InputError(message, field="--randomization", choices=[*shipped, NONE, "FILE.toml"])
    path = resources.find(name_or_path, "models/randomization", ".toml")
    return variation_from_table(read_toml(path), path)


def sample_world(
    randomization: str | Path, seed: int, design: SensorDesign, file: SimRigFile
) -> SampledWorld:
    """Sample the world of `seed` for the rig of `file` with `design` on its fingers.
    `randomization` is as in `load_variation`."""
    return load_variation(randomization).sample(
        seed, fingers=[finger.name for finger in file.fingers], markers=design.markers.count
    )


def variation_from_table(table: Mapping[str, Any], path: Path) -> Randomization:
    """Validate a parsed TOML table; see `load_variation`."""
    root = Section(table, "", str(path))
    spreads = {}
    for name, known in SECTIONS.items():
        section = root.optional(name)
        if section is None:
            continue
        spreads |= {
            f"{name}.{entry.key}": (entry, spread)
            for entry in known
            if (spread := _read_spread(section, entry)) is not None
        }
        section.done()
    root.done()
    return Randomization(path.stem, spreads, path)


def _read_spread(section: Section, entry: Number) -> Spread | None:
    """Read one field: a number, [low, high], {mean, sd} or {choices}."""
    kind = section.kind(entry.key)
    if kind is None:
        # register the key, which is optional
        section.number(entry.key, entry.low, entry.high, default=None)
        return None
    if kind is list:
        low, high = section.numbers(entry.key, ("low", "high"), entry.low, entry.high)
        if low > high:
            message = f"[{low:g}, {high:g}] is not an ascending range [low, high]"
            raise section.fail(entry.key, message)
        return Spread(low, high)
    if kind is not dict:
        value = section.number(entry.key, entry.low, entry.high)
        return Spread(value, value)
    inner = section.section(entry.key)
    if inner.has("choices"):
        spread = Spread(choices=tuple(float(value) for value in inner.array("choices", (None,))))
        if not spread.choices:
            raise section.fail(entry.key, "no choices")
        worst = (min(spread.choices), max(spread.choices))
    else:
        spread = Spread(
            mean=inner.number("mean", entry.low, entry.high, default=0.0),
            sd=inner.number("sd", 0, entry.high - entry.low),
        )
        assert spread.mean is not None
        worst = (spread.mean - _CUT * spread.sd, spread.mean + _CUT * spread.sd)
    inner.done()
    if not (entry.low <= worst[0] and worst[1] <= entry.high):
        limits = f"outside {entry.low:g} to {entry.high:g}"
        raise section.fail(entry.key, f"reaches from {worst[0]:g} to {worst[1]:g}, {limits}")
    return spread


def _sample(name: str, entry: Number, spread: Spread, seed: int, markers: int) -> Any:
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    if entry.key == MISSING:
        count = min(int(spread.at(rng.random()) + 0.5), markers)
        return sorted(int(marker) for marker in rng.choice(markers, count, replace=False))
    # as it will be written
    names = entry.names if isinstance(entry, Numbers) else ()
    rounded = [float(f"{spread.at(fraction):.6g}") for fraction in rng.random(max(len(names), 1))]
    return rounded if names else rounded[0]
