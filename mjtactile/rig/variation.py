"""What varies from one grasp to the next: a file of ranges and distributions, and the values that a
seed draws from it.

    design, file = load_sensor("dense"), load_sim_rig("sim") rig = build_sim_rig(design,
    object_name="egg", seed=3, file=file, drawn=draw("default", 3, design, file))

The world is made of the drawn values; sensing and control keep the sensor file and the rig file. A
value depends on the seed and on its own name alone, so that one more line in a file leaves the
others as they were. The format: docs/evaluate.md.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from mjtactile.core import resources
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.toml import Section, read_toml
from mjtactile.rig.simulated import SimRigFile
from mjtactile.rig.specimen import GAS_ROWS, MISSING, SENSOR_ROWS, Row, SpecimenConfig, specimen_of

NONE = "none"
_CUT = 3.0
"""sd at which a normal distribution ends: what is drawn has bounds."""
_MISSING_MOST = 40


@dataclass(frozen=True)
class ObjectChange:
    """How the object differs from its file: everything that stands in it larger by `size`, with its
    mass; then `mass`, `friction` (with the membranes, the table and its stand), `stiffness` of its
    springs or elements and `breaking` (what it stands) more, all shares. `place` (x, y) m on the
    table and `yaw` rad replace those of the seed (None: they do not)."""

    size: float = 0.0
    mass: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    breaking: float = 0.0
    place: tuple[float, float] | None = None
    yaw: float | None = None


UNCHANGED = ObjectChange()


@dataclass(frozen=True)
class RigChange:
    """How the gripper differs from its file: commands take effect `delay` s later and up to
    `jitter` s more; `backlash` m of the opening in its gears; `speed` more of it, a share;
    `force_noise` N (sd) of the closing force that the servos report."""

    delay: float = 0.0
    jitter: float = 0.0
    backlash: float = 0.0
    speed: float = 0.0
    force_noise: float = 0.0


FAULTLESS = RigChange()


@dataclass(frozen=True)
class Drawn:
    """The world of one grasp. `values` are as drawn, in the file's units, by name: what a result
    keeps."""

    object: ObjectChange = UNCHANGED
    rig: RigChange = FAULTLESS
    specimens: tuple[SpecimenConfig, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)

    def specimen(self, finger: str) -> SpecimenConfig:
        """That finger's; one like the sensor file where nothing else is said."""
        return next((one for one in self.specimens if one.finger == finger), SpecimenConfig(finger))


AS_FILED = Drawn()
"""A world in which everything is as its file says."""
_PERCENT = 1e-2
_OBJECT_ROWS = (
    Row("size_percent", "size", -50, 100, _PERCENT),
    Row("mass_percent", "mass", -90, 900, _PERCENT),
    Row("friction_percent", "friction", -95, 400, _PERCENT),
    Row("stiffness_percent", "stiffness", -90, 900, _PERCENT),
    Row("breaking_percent", "breaking", -90, 900, _PERCENT),
    Row("place_mm", "place", -30, 30, 1e-3, "xy"),
    Row("yaw_deg", "yaw", -180, 180, math.pi / 180),
)
_RIG_ROWS = (
    Row("delay_ms", "delay", 0, 1000, 1e-3),
    Row("jitter_ms", "jitter", 0, 1000, 1e-3),
    Row("backlash_mm", "backlash", 0, 10, 1e-3),
    Row("speed_percent", "speed", -90, 400, _PERCENT),
    Row("force_noise_N", "force_noise", 0, 10),
)
_COUNT = Row(MISSING, "missing", 0, _MISSING_MOST)
SECTIONS: dict[str, tuple[Row, ...]] = {
    "object": _OBJECT_ROWS,
    "sensor": (*SENSOR_ROWS, _COUNT),
    "gas": GAS_ROWS,
    "rig": _RIG_ROWS,
}
"""What can vary; `sensor` and `gas` are drawn for each finger."""


@dataclass(frozen=True)
class Spread:
    """A distribution: evenly from `low` to `high`, around a `mean` with an `sd` (normal, cut at
    three of them), or one of `choices`, each as likely."""

    low: float = 0.0
    high: float = 0.0
    mean: float | None = None
    sd: float = 0.0
    choices: tuple[float, ...] = ()

    def at(self, share: float) -> float:
        """The value below which this `share`, 0 to 1, of all lies."""
        if self.choices:
            return self.choices[min(int(share * len(self.choices)), len(self.choices) - 1)]
        if self.mean is None:
            return self.low + share * (self.high - self.low)
        normal = NormalDist()
        tail = normal.cdf(-_CUT)
        return self.mean + self.sd * normal.inv_cdf(tail + share * (1 - 2 * tail))


@dataclass(frozen=True)
class Variation:
    """A file of ranges: of each name ("object.size_percent") its row and its distribution."""

    name: str
    spreads: Mapping[str, tuple[Row, Spread]]
    path: Path | None = None

    def draw(self, seed: int, *, fingers: Sequence[str], markers: int) -> Drawn:
        """The world of `seed` for these fingers, with so many `markers` on each; the same whatever
        else is drawn or run."""
        values: dict[str, Any] = {}
        for name, (row, spread) in self.spreads.items():
            section, _, key = name.partition(".")
            owners = fingers if section in ("sensor", "gas") else [section]
            values |= {
                f"{owner}.{key}": _draw(f"{owner}.{key}", row, spread, seed, markers)
                for owner in owners
            }
        own = {
            owner: {
                name.partition(".")[2]: value
                for name, value in values.items()
                if name.startswith(f"{owner}.")
            }
            for owner in ("object", "rig", *fingers)
        }
        changes = (
            ObjectChange(**_by_attribute(_OBJECT_ROWS, own["object"])),
            RigChange(**_by_attribute(_RIG_ROWS, own["rig"])),
        )
        return Drawn(
            *changes, tuple(specimen_of(finger, own[finger]) for finger in fingers), values
        )


def load_variation(name_or_path: str | Path) -> Variation:
    """Read a variation by shipped name or from a TOML file; "none" varies nothing.

    Raises InputError naming file, field and valid choices for what is unknown, out of range or no
    distribution.
    """
    if name_or_path == NONE:
        return Variation(NONE, {})
    text = str(name_or_path)
    shipped = resources.names("models/variations", ".toml")
    if not text.endswith(".toml") and "/" not in text and text not in shipped:
        raise InputError(
            f"unknown variation {text!r}", field="--vary", choices=[*shipped, NONE, "FILE.toml"]
        )
    path = resources.find(name_or_path, "models/variations", ".toml")
    return variation_from_table(read_toml(path), path)


def draw(vary: str | Path, seed: int, design: SensorDesign, file: SimRigFile) -> Drawn:
    """The world of `seed` for the rig of `file` with `design` on its fingers; `vary` as in
    `load_variation`."""
    return load_variation(vary).draw(
        seed, fingers=[finger.name for finger in file.fingers], markers=design.markers.count
    )


def variation_from_table(table: Mapping[str, Any], path: Path) -> Variation:
    """Validate a parsed TOML table; see `load_variation`."""
    root = Section(table, "", str(path))
    spreads = {}
    for name, rows in SECTIONS.items():
        section = root.optional(name)
        if section is None:
            continue
        spreads |= {
            f"{name}.{row.key}": (row, spread)
            for row in rows
            if (spread := _spread(section, row)) is not None
        }
        section.done()
    root.done()
    return Variation(path.stem, spreads, path)


def _spread(section: Section, row: Row) -> Spread | None:
    """One field: a number, [low, high], {mean, sd} or {choices}."""
    kind = section.kind(row.key)
    if kind is None:
        # it is known now, and may be missing
        section.number(row.key, row.low, row.high, default=None)
        return None
    if kind is list:
        low, high = section.numbers(row.key, ("low", "high"), row.low, row.high)
        if low > high:
            raise section.fail(row.key, f"[{low:g}, {high:g}] is not [low, high]")
        return Spread(low, high)
    if kind is not dict:
        value = section.number(row.key, row.low, row.high)
        return Spread(value, value)
    inner = section.section(row.key)
    if inner.has("choices"):
        spread = Spread(choices=tuple(float(value) for value in inner.array("choices", (None,))))
        if not spread.choices:
            raise section.fail(row.key, "no choices")
        worst = (min(spread.choices), max(spread.choices))
    else:
        spread = Spread(
            mean=inner.number("mean", row.low, row.high, default=0.0),
            sd=inner.number("sd", 0, row.high - row.low),
        )
        assert spread.mean is not None
        worst = (spread.mean - _CUT * spread.sd, spread.mean + _CUT * spread.sd)
    inner.done()
    if not (row.low <= worst[0] and worst[1] <= row.high):
        raise section.fail(
            row.key,
            f"reaches from {worst[0]:g} to {worst[1]:g}, outside {row.low:g} to {row.high:g}",
        )
    return spread


def _draw(name: str, row: Row, spread: Spread, seed: int, markers: int) -> Any:
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    if row.attribute == "missing":
        count = min(int(spread.at(rng.random()) + 0.5), markers)
        return sorted(int(number) for number in rng.choice(markers, count, replace=False))
    # as it will be written
    drawn = [float(f"{spread.at(share):.6g}") for share in rng.random(max(len(row.names), 1))]
    return drawn if row.names else drawn[0]


def _by_attribute(rows: Sequence[Row], values: Mapping[str, Any]) -> dict[str, Any]:
    return {row.attribute: row.si(values[row.key]) for row in rows if row.key in values}
