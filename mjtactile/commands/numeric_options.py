"""Numbers on the command line: single values, pairs, ranges A:B:STEP, and which images to keep."""

from __future__ import annotations

import argparse
import math

from mjtactile.commands import arguments as arg

MAX_STEPS = 10_000


def numbers(text: str) -> list[float]:
    """Read "2", or "0:4:0.5" (both ends included). For argparse; raises its error naming the
    form."""
    parts = text.split(":")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) not in (1, 3) or not all(math.isfinite(value) for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor a range A:B:STEP")
    if len(values) == 1:
        return values
    start, stop, step = values
    if step == 0 or (stop - start) / step < 0:
        raise argparse.ArgumentTypeError(
            f"{text!r}: the step {step:g} does not lead from {start:g} to {stop:g}"
        )
    count = math.floor((stop - start) / step + 1e-9) + 1
    if count > MAX_STEPS:
        raise argparse.ArgumentTypeError(
            f"{text!r} has {count} steps; at most {MAX_STEPS} are allowed"
        )
    return [start + i * step for i in range(count)]


def pair(text: str) -> tuple[float, float]:
    """Read "X,Y"."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a pair of numbers X,Y")
    return x, y


def finite(text: str) -> float:
    """Read one finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def frames(text: str) -> int:
    """Read "none" (0), "all" (1) or "every:N" (N)."""
    word, _, number = text.partition(":")
    if word == "every" and number.isdecimal() and int(number) > 0:
        return int(number)
    if text not in ("none", "all"):
        raise argparse.ArgumentTypeError(f"{text!r} is not none, every:N or all")
    return int(text == "all")


FRAMES = arg.option(
    "--frames",
    "none|every:N|all",
    "camera images kept in the recording: none, of every N-th cycle, or all (default). "
    "Without all of them it cannot be replayed; two cameras take 9 MB per second",
    1,
    type=frames,
)
