"""Flags of a run: reasons why its numbers are less accurate than usual, with the time of each.

`FLAGS` is the registry of all kinds. The page `docs/reference/status_and_flags.md` shows it as a
table (`mjtactile bench flags-page --readme`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from mjtactile.core.renamed import FLAGS as RENAMED


class Cadence(Enum):
    """Period of the check that raises and clears a flag; in parentheses without a mesh."""

    START = "start"
    FAST = "20 ms (0.1 s)"
    CONTACT = "20 ms (2 s)"
    SLOW = "0.1 s (2 s)"
    CYCLE = "control cycle"
    SETTLING = "press, inflation"


SIMULATION = frozenset({Cadence.FAST, Cadence.CONTACT, Cadence.SLOW})
"""Cadences of the periodic checks of a simulation."""


@dataclass(frozen=True)
class FlagKind:
    """Kind of a flag.

    Attributes:
        name: Key in Python, JSON and recordings.
        meaning: Condition that raises the flag. The reason of a raised flag has the values.
        cause: Usual cause.
        remedy: Change that clears the flag.
        cadence: Period of the check.
        grows: True if the reason has an amount. It is replaced when the amount grows. Otherwise the
            first reason is kept.
        bypasses: True if the flag is a force outside of the membranes, which can make a grasp fail.
    """

    name: str
    meaning: str
    cause: str
    remedy: str
    cadence: Cadence
    grows: bool = False
    bypasses: bool = False


_KINDS = (
    FlagKind(
        "stretch",
        "stretch above 1.4, where real rubber is not neo-Hookean; or a bulge more than 2 % too low",
        "high pressure or load; `hyperelasticity` off",
        "less pressure, a thicker membrane; `hyperelasticity` on",
        Cadence.SLOW,
    ),
    FlagKind(
        "wrinkles",
        "more than 1 % of the membrane is under compression, where a real one wrinkles",
        "pre-stretch of 1 or less, strong shear",
        "`pre_stretch` above 1, more pressure",
        Cadence.SLOW,
    ),
    FlagKind(
        "bending",
        "omitted bending would add more than 5 % to the stiffness",
        "a thick or slack membrane",
        "a thinner or more stretched membrane",
        Cadence.START,
    ),
    FlagKind(
        "mesh",
        "heights are more than 2 % off",
        "a coarse mesh",
        "a finer mesh; 13 x 11 has 1-3 %",
        Cadence.START,
    ),
    FlagKind(
        "small_feature",
        "a contact geometry is finer than the mesh resolves",
        "a pin, a small ball",
        "the mesh that the reason names, or trust position and time only",
        Cadence.FAST,
    ),
    FlagKind(
        "sharp_edge",
        "a face with sharp edges is in contact, or a wider face reaches the last "
        "vertices in front of the frame",
        "edge position between vertices: 0.5 to 1.2 times the force of a 12 mm box, 0.3 "
        "to 1.4 times of a 6 mm box; next to the frame 10 %",
        "a finer mesh",
        Cadence.CONTACT,
    ),
    FlagKind(
        "hull",
        "MuJoCo uses the convex hull of a mesh in contact",
        "a non-convex mesh",
        "convex geoms; `press` splits it with `mjtactile[meshes]`",
        Cadence.CONTACT,
    ),
    FlagKind(
        "shape",
        "`press` only: the membrane is too coarse for the contact shape",
        "the mesh bends at its vertices only",
        "the `--mesh` that the reason names",
        Cadence.START,
    ),
    FlagKind(
        "penetration",
        "objects penetrate by more than 5 % of the indentation, longer than a moment",
        "soft contact",
        "a smaller time step",
        Cadence.CONTACT,
    ),
    FlagKind(
        "speed",
        "an object approaches by more than half its size per step",
        "a fast object",
        "the time step that the reason names",
        Cadence.SLOW,
    ),
    FlagKind(
        "solver",
        "the solver does not converge; forces are rough",
        "a free light object on a stiff contact",
        "a smaller time step",
        Cadence.FAST,
    ),
    FlagKind(
        "chatter",
        "the normal force varies from step to step by more than 2 % and 5 mN (sd)",
        "a face that slides to and fro: its vertices lose contact where it turns",
        "a time step of 2 ms; slower motion",
        Cadence.FAST,
        grows=True,
    ),
    FlagKind(
        "frame_contact",
        "the frame carries more than 0.2 N, which no marker shows",
        "contact outside the membrane",
        "move the contact to the membrane",
        Cadence.FAST,
        grows=True,
        bypasses=True,
    ),
    FlagKind(
        "carrier_contact",
        "a geom to which the sensor is fixed carries more than 0.2 N",
        "a part of the robot in the chamber or in front of the frame",
        "move the site forward, set `contype` and `conaffinity` of the geom to 0, or "
        "`attach(..., carrier_contact=False)`",
        Cadence.FAST,
        grows=True,
        bypasses=True,
    ),
    FlagKind(
        "rim_contact",
        "without `mesh`: a geom lies on the rim, whose load the model omits",
        "2 to 12 % where a 30 mm ball lies on the rim",
        "`mesh` on",
        Cadence.FAST,
    ),
    FlagKind(
        "quasistatic",
        "without `mesh`: no equilibrium; the force is extrapolated",
        "an object that is too steep or thin, or at the glass",
        "`mesh` on",
        Cadence.FAST,
        grows=True,
    ),
    FlagKind(
        "unsensed_force",
        "rig: the servos push more than the fingers measure, beyond friction and torque tolerance",
        "contact on frames, finger sides or between the jaws",
        "clear the jaws; calibrate the gripper",
        Cadence.CYCLE,
        grows=True,
        bypasses=True,
    ),
    FlagKind(
        "uncertain",
        "the sd of a force exceeds a quarter of it for 0.2 s; light touches do not count",
        "a load that the markers show in part",
        "a pressure sensor, fiducials",
        Cadence.CYCLE,
        grows=True,
    ),
    FlagKind(
        "strain",
        "a soft object is compressed by more than 20 %, where rubber is stiffer than its elements",
        "a large squeeze",
        "less force",
        Cadence.FAST,
    ),
    FlagKind(
        "unsettled",
        "`press` or `inflate` did not come to rest",
        "vibration, a light load",
        "more load",
        Cadence.SETTLING,
    ),
)
FLAGS: Mapping[str, FlagKind] = {kind.name: kind for kind in _KINDS}
"""All kinds of flags by name, in the order of their table."""

Reasons = dict[str, str]
"""Reasons of the flags that a check raises now, by kind."""


class Flag(str):
    """Flag of a run: the reason as text, with its time.

    `first` and `last` are the first and last time at which the flag was up, s, on the clock of the
    rig or scene. `fraction` is the fraction of the time in which it was up. All are NaN if unknown,
    as in recordings from before 0.2.0.
    """

    __slots__ = ("first", "fraction", "last")
    first: float
    last: float
    fraction: float

    def __new__(
        cls,
        reason: str,
        first: float = math.nan,
        last: float = math.nan,
        fraction: float = math.nan,
    ) -> Flag:
        self = super().__new__(cls, reason)
        self.first = first
        self.last = last
        self.fraction = fraction
        return self

    @property
    def when(self) -> str:
        """Time for a message: "0.40 to 8.10 s, 95 % of the time"; empty if unknown."""
        if not math.isfinite(self.first + self.last + self.fraction):
            return ""
        return f"{self.first:.2f} to {self.last:.2f} s, {100 * self.fraction:.0f} % of the time"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of the flag. Unknown times are NaN (null in JSON)."""
        return {
            "reason": str(self),
            "first_s": self.first,
            "last_s": self.last,
            "fraction": self.fraction,
        }

    def __reduce__(self) -> tuple[type[Flag], tuple[str, float, float, float]]:
        return Flag, (str(self), self.first, self.last, self.fraction)


Flags = Mapping[str, Flag]
"""Flags of a run by kind."""


def read_flags(table: Mapping[str, Any]) -> dict[str, Flag]:
    """Read the flags of a JSON object.

    Args:
        table: A flag, or the object of `Flag.to_dict`, by kind; before 0.2.0 the reason alone.

    Returns:
        Flags by their current kind.
    """
    flags = {}
    for kind, value in table.items():
        if isinstance(value, Flag):
            flags[kind] = value
            continue
        entry = value if isinstance(value, Mapping) else {"reason": value}
        times = [_number(entry.get(key)) for key in ("first_s", "last_s", "fraction")]
        flags[RENAMED.get(kind, kind)] = Flag(str(entry.get("reason", "")), *times)
    return flags


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def bypassing_loads(flags: Mapping[str, str]) -> list[str]:
    """Return the reasons of flags for forces outside of the membranes, without their remedies."""
    kinds = (kind for kind in FLAGS.values() if kind.bypasses and kind.name in flags)
    return [str(flags[kind.name]).split("; ")[0] for kind in kinds]


def merge_flags(many: Iterable[Flags]) -> dict[str, Flag]:
    """Merge the flags of several scenes or monitors.

    Args:
        many: Flags of each, the most important first.

    Returns:
        For each kind the first reason, the earliest and latest time and the largest fraction.
    """
    merged: dict[str, Flag] = {}
    for flags in many:
        for kind, flag in flags.items():
            old = merged.get(kind)
            merged[kind] = flag if old is None else _union(old, flag)
    return merged


def _union(flag: Flag, other: Flag) -> Flag:
    first, last, fraction = (
        choose((a for a in pair if not math.isnan(a)), default=math.nan)
        for choose, pair in (
            (min, (flag.first, other.first)),
            (max, (flag.last, other.last)),
            (max, (flag.fraction, other.fraction)),
        )
    )
    return Flag(str(flag), first, last, fraction)


class FlagTracker:
    """Flags of a run so far.

    Each check reports its reasons with `update`. A flag is up from the check that raises it until a
    check of its cadence does not.

    Args:
        time: Start of the run, s.
        reasons: Flags that are up from the start.
    """

    def __init__(self, time: float, reasons: Mapping[str, str] | None = None):
        self._start = time
        self._time = time
        self._reasons: dict[str, str] = {}
        self._first: dict[str, float] = {}
        self._last: dict[str, float] = {}
        self._duration: dict[str, float] = {}
        self._up: frozenset[str] = frozenset()
        self.update(time, reasons or {})

    def __contains__(self, kind: str) -> bool:
        """Return True if the flag was up at any time."""
        return kind in self._reasons

    def update(
        self, time: float, reasons: Mapping[str, str], checked: Collection[Cadence] = ()
    ) -> None:
        """Add the result of a check.

        Args:
            time: Time of the check, s.
            reasons: Flags that are up, by kind.
            checked: Cadences of this check. Their flags are cleared unless they are in `reasons`.

        Raises:
            KeyError: A kind is not in `FLAGS`.
        """
        self._advance(time)
        for kind, reason in reasons.items():
            if FLAGS[kind].grows or kind not in self._reasons:
                self._reasons[kind] = reason
            self._first.setdefault(kind, time)
            self._last[kind] = time
            self._duration.setdefault(kind, 0.0)
        kept = {kind for kind in self._up if FLAGS[kind].cadence not in checked}
        self._up = frozenset(kept | reasons.keys())

    def flags(self, time: float | None = None) -> dict[str, Flag]:
        """Return all flags so far, in the order of their first occurrence.

        Args:
            time: Present time, s; default: that of the last check.
        """
        if time is not None:
            self._advance(time)
        elapsed = self._time - self._start
        return {
            kind: Flag(
                reason,
                self._first[kind],
                self._last[kind],
                self._duration[kind] / elapsed if elapsed > 0 else float(kind in self._up),
            )
            for kind, reason in self._reasons.items()
        }

    def _advance(self, time: float) -> None:
        for kind in self._up:
            self._duration[kind] += time - self._time
            self._last[kind] = time
        self._time = time


def table() -> str:
    """Return the registry as a table in Markdown."""
    lines = [
        "| flag | meaning | cause | remedy | checked every (without `mesh`) |",
        "|---" * 5 + "|",
    ]
    for kind in FLAGS.values():
        cells = (f"`{kind.name}`", kind.meaning, kind.cause, kind.remedy, kind.cadence.value)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
