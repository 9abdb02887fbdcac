"""What gripper and valves report."""

from __future__ import annotations

from dataclasses import dataclass

FINGERS = ("left", "right")
"""What the fingers of a pair are called, in this order."""


@dataclass(frozen=True)
class GripperState:
    """What the gripper reports.

    Attributes:
        opening: m between the two sensors' frames.
        speed: m/s of the opening.
        effort: N at the jaw, as the servo believes it.
        lift_height: m of the hand above where it started.
        time: s on the rig's clock at which it was so (NaN: not known).
        age: s from then until it was handed over (NaN: not known).
    """

    opening: float
    speed: float
    effort: float
    lift_height: float
    time: float = float("nan")
    age: float = float("nan")


@dataclass(frozen=True)
class ValveState:
    """What the valve of one chamber reports.

    Attributes:
        is_open: Whether the chamber is connected to its supply.
        gauge_pressure: Pa in the chamber above ambient; None where the rig has no pressure sensor.
        time: s on the rig's clock at which it was measured (NaN: not known).
        age: s from then until it was handed over (NaN: not known).
    """

    is_open: bool
    gauge_pressure: float | None = None
    time: float = float("nan")
    age: float = float("nan")


@dataclass(frozen=True)
class PressureReading:
    """What the pressure gauge of a chamber showed at `time` s on the images' clock: Pa above the
    air's, its zero taken off, with its `sd`; and whether the valve was open then."""

    gauge_pressure: float
    sd: float
    time: float
    is_open: bool = False
