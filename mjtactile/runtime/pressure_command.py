"""Pressures of a command: checks, start of their rate limits, transfer to the valves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mjtactile.core.errors import InputError
from mjtactile.core.types import Command, ValveState
from mjtactile.rig.finger import Rig


def check(rig: Rig, wanted: Command) -> None:
    """Raise InputError if the rig has no controllable valve with a pressure sensor, or the number
    of pressures differs from that of its fingers."""
    if wanted.gauge_pressure is None:
        return
    if rig.limits.pressure is None:
        message = (
            f"rig {rig.name!r} has no controllable valves with a pressure sensor: the "
            "pressure in its fingers cannot be changed"
        )
        raise InputError(message, source="Command", field="gauge_pressure")
    if len(wanted.gauge_pressure) != len(rig.fingers):
        message = f"{len(wanted.gauge_pressure)} pressures for {len(rig.fingers)} fingers"
        raise InputError(message, source="Command", field="gauge_pressure")


def started(rig: Rig, wanted: Command, last: Command, valves: Sequence[ValveState]) -> Command:
    """Return the previous command, with pressures from which the rate limits start.

    The first pressures start at the sensor readings, or without a reading at the requested
    value.
    """
    if wanted.gauge_pressure is None or last.gauge_pressure is not None:
        return last
    pairs = zip(wanted.gauge_pressure, rig.readings(valves), strict=True)
    shown = tuple(one if gauge is None else gauge.gauge_pressure for one, gauge in pairs)
    return replace(last, gauge_pressure=shown)


def send(rig: Rig, command: Command, last: Command) -> None:
    """Make each finger's valve follow a command, or stop its control when no pressure is commanded.

    Raises DeviceError if a valve does not respond.
    """
    if command.gauge_pressure is None and last.gauge_pressure is None:
        return
    pressures = command.gauge_pressure or (None,) * len(rig.fingers)
    for finger, pressure in zip(rig.fingers, pressures, strict=True):
        finger.regulate_pressure(pressure)
