"""`--time-scale N`: run emulated rigs at a fraction of the normal speed.

It is for computers that are too slow for real time.
"""

from __future__ import annotations

import argparse

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.core import scaled_clock

_MOST = 100.0


def _times(text: str) -> float:
    try:
        times = float(text)
    except ValueError:
        times = 0.0
    if not 1 <= times <= _MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to {_MOST:g}")
    return times


ARGUMENT = arg.option(
    "--time-scale",
    "N",
    "emulated rig: run its world, watchdogs and heartbeats, and this program's time-outs, at "
    "1/N of the speed, for a slow computer (default: 1)",
    type=_times,
)


def apply(slow: float | None, rig: str) -> None:
    """Set the pace of this run. Raises InputError for a rig that has no clock to be slowed."""
    if slow is None:
        return
    if rig == "sim" or rig.startswith("replay:"):
        raise InputError(
            f"the rig {rig!r} has no clock; only emulated devices can run slower",
            field="--time-scale",
        )
    scaled_clock.set_slow(slow)
