"""States of gripper and valves."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.signature_checks import validated

FINGERS = ("left", "right")
"""Names of the fingers of a pair, in this order."""


@validated()
@dataclass(frozen=True)
class GripperState:
    """State of the gripper.

    Attributes:
        opening: Distance between the two sensors' frames, m.
        speed: Rate of change of the opening, m/s.
        effort: Force at the jaw, estimated from the servo's current, N.
        lift_height: Height of the gripper above its start, m.
        time: Time of the measurement on the rig's clock, s (NaN: unknown).
        age: Time from the measurement to its delivery, s (NaN: unknown).
    """

    opening: float
    speed: float
    effort: float
    lift_height: float
    time: float = float("nan")
    age: float = float("nan")


@validated()
@dataclass(frozen=True)
class ValveState:
    """State of the valve of one chamber.

    Attributes:
        is_open: True if the chamber is connected to its supply.
        gauge_pressure: Gauge pressure in the chamber, Pa; None if the rig has no pressure sensor.
        time: Time of the measurement on the rig's clock, s (NaN: unknown).
        age: Time from the measurement to its delivery, s (NaN: unknown).
    """

    is_open: bool
    gauge_pressure: float | None = None
    time: float = float("nan")
    age: float = float("nan")


@dataclass(frozen=True)
class PressureReading:
    """Reading of a chamber's pressure sensor at `time` s on the images' clock.

    The gauge pressure, Pa, is corrected by the sensor's zero and has the standard deviation `sd`.
    `is_open` is the state of the valve at that time.
    """

    gauge_pressure: float
    sd: float
    time: float
    is_open: bool = False
