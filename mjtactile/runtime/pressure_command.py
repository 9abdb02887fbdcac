"""The pressures of a command: who obeys them, where they begin, and how they reach the valves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mjtactile.core.errors import InputError
from mjtactile.core.types import Command, ValveState
from mjtactile.rig.finger import Rig


def check(rig: Rig, wanted: Command) -> None:
    """Refuse pressures that this rig cannot give.

    Raises:
        InputError: No valve of it obeys, or the number is not that of its fingers.
    """
    if wanted.pressure_gauge is None:
        return
    if rig.limits.pressure is None:
        raise InputError(
            f"rig {rig.name!r} has no valves with a pressure gauge that obey: the air in its "
            "fingers stays as it is",
            source="Command",
            field="pressure_gauge",
        )
    if len(wanted.pressure_gauge) != len(rig.fingers):
        raise InputError(
            f"{len(wanted.pressure_gauge)} pressures for {len(rig.fingers)} fingers",
            source="Command",
            field="pressure_gauge",
        )


def started(rig: Rig, wanted: Command, last: Command, valves: Sequence[ValveState]) -> Command:
    """The command before, from which the limits reckon: the first pressures begin at what the
    gauges show; those that are silent at what is wanted."""
    if wanted.pressure_gauge is None or last.pressure_gauge is not None:
        return last
    pairs = zip(wanted.pressure_gauge, rig.readings(valves), strict=True)
    shown = tuple(one if gauge is None else gauge.pressure_gauge for one, gauge in pairs)
    return replace(last, pressure_gauge=shown)


def send(rig: Rig, command: Command, last: Command) -> None:
    """Have each finger's valve follow a command, or let go of the air when none is commanded any
    more.

    Raises:
        DeviceError: A valve does not obey.
    """
    if command.pressure_gauge is None and last.pressure_gauge is None:
        return
    pressures = command.pressure_gauge or (None,) * len(rig.fingers)
    for finger, pressure in zip(rig.fingers, pressures, strict=True):
        finger.follow(pressure)
