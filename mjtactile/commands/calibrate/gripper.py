"""`mjtactile calibrate gripper`: zero, scale and backlash of the opening, current to force."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate.terminal import ask, check_folder, confirm, finish, notify
from mjtactile.commands.output import stdout_to_stderr

Instrument = Callable[[str], float | None]
"""Instrument that returns a reading for a prompt; None: no further readings."""
_OPENING_PARTS = (0.6, 0.9)  # fractions of the gripper's range
_FORCE_PARTS = (0.3, 0.5, 0.7, 0.85, 1.0)  # fractions of the largest force
HELP = "jaw zero, scale, backlash and current to force, against a caliper and a load cell"
DESCRIPTION = """\
Openings: the jaws move to several openings, each from both sides. You measure the gap between
the sensors' frames with a caliper and enter it. This gives zero, scale and backlash.
Forces: the jaws squeeze a load cell with increasing current, and you enter its reading (or
`--skip-forces`). This gives the torque per ampere, which data sheets specify to 20 %.
Live on a rig (--rig), or from existing readings (--openings, --forces). On the emulated rig the
emulated world provides caliper and load cell, and the jaws squeeze the object in it."""
EPILOG = """\
examples:
  mjtactile calibrate gripper --rig my_gripper.toml --out gripper.json
  mjtactile calibrate gripper --rig my_gripper.toml --openings caliper.csv --forces loadcell.csv
  mjtactile calibrate gripper --rig emulated --skip-forces --out gripper.json

With CSV files nothing moves and nothing is connected; --rig only defines the servos:
  --openings: reported_mm, direction (closing or opening: the last motion), measured_mm;
              at least two openings 5 mm apart, each from both sides
  --forces:   reported_N (the effort that the servos report), measured_N; at least 4
Writes the file that the rig file names ([gripper] calibration = "gripper.json"), which
every run with this rig then uses, or --out: verdict, reasons, date, versions, opening
{offset_mm, scale, backlash_mm, each with _sd; rms_mm}, force {factor, offset_N, each with
_sd; rms_N} and `servo`: zero_ticks, mm_per_rad, torque_Nm_per_A of each. Refused (exit code
1): scale off by 3 %, readings 0.2 mm off the fit, backlash above 1 mm; force factor outside
0.5 to 1.5, readings 10 % off a line.
"""

ARGUMENTS = (
    arg.option("--rig NAME|FILE.toml", "the gripper's rig file", required=True),
    arg.option("--openings FILE.csv", "caliper readings, instead of moving the jaws", type=Path),
    arg.option("--forces FILE.csv", "load cell readings, instead of squeezing", type=Path),
    arg.flag("--skip-forces", "calibrate only the opening"),
    arg.option(
        "--opening-mm LOW HIGH",
        "openings to move between; the gap must be free (default: 60 and 90 %% of the "
        "gripper's range)",
        dest="range",
        nargs=2,
        type=float,
    ),
    arg.option(
        "--force-N F",
        "maximum squeezing force (default: half of the rig file's force_max_N)",
        dest="force",
        type=float,
    ),
    arg.option("--object NAME|FILE.xml", "emulated rig: object to squeeze", "egg"),
    arg.out(
        "output file (default: the calibration file named in [gripper] of the rig file)",
        "FILE.json",
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile import load_rig_file
    from mjtactile.calibrate.gripper import calibrate_force, calibrate_opening, report
    from mjtactile.calibrate.result_io import stamp, write

    rig_file = load_rig_file(options.rig)
    out = options.out or rig_file.gripper.calibration
    if out is None:
        message = (
            'no output file is named: write calibration = "gripper.json" into [gripper] '
            "(of a copy, for a shipped rig), or add --out"
        )
        raise InputError(message, source=rig_file.path, field="gripper.calibration")
    check_folder(out)
    recorded = options.openings is not None or options.forces is not None
    with stdout_to_stderr():
        openings, forces = _read(options) if recorded else _live(options)
    opening = calibrate_opening(*openings) if openings is not None else None
    force = calibrate_force(*forces) if forces is not None else None
    reasons = []
    if opening is not None:
        reasons += [f"opening: {text}" for text in opening.reasons]
    if force is not None:
        reasons += [f"force: {text}" for text in force.reasons]
    result: dict[str, Any] = stamp("gripper", reasons) | report(rig_file, opening, force)
    lines = _lines(opening, force, result["servo"], bool(reasons))
    return finish(options, write(out, result), result, lines)


def _read(options: argparse.Namespace) -> tuple[Any, Any]:
    """Read openings and forces from the given files; None: no such file."""
    from mjtactile.calibrate.result_io import read_columns

    openings = None
    forces = None
    if options.openings is not None:
        table = read_columns(
            options.openings, ("reported_mm", "measured_mm"), ("direction",), fewest=4
        )
        openings = 1e-3 * table["reported_mm"], table["direction"], 1e-3 * table["measured_mm"]
    if options.forces is not None:
        table = read_columns(options.forces, ("reported_N", "measured_N"), fewest=4)
        forces = table["reported_N"], table["measured_N"]
    return openings, forces


def _live(options: argparse.Namespace) -> tuple[Any, Any]:
    """Measure openings and forces on the rig, after checking the options."""
    from mjtactile import load_sensor
    from mjtactile.calibrate.connect import live_gripper, live_rig
    from mjtactile.calibrate.interactive import measure_forces, measure_openings

    with contextlib.ExitStack() as stack:
        rig_file, emulator = stack.enter_context(
            live_rig(options.rig, load_sensor("dense"), object_name=options.object)
        )
        config = rig_file.gripper
        low, high = _range(options, config)
        maximum = _force_max(options, config)
        gripper = stack.enter_context(live_gripper(rig_file))
        caliper, load_cell = _instruments(emulator)
        notify(
            "the jaws move now; keep fingers and objects out of the gap. Ctrl-C stops and "
            "switches the torque off."
        )
        openings = measure_openings(
            gripper, [low, (low + high) / 2, high], caliper, 0.25 * config.force_max, notify
        )
        if options.skip_forces:
            return openings, None
        if emulator is None:
            confirm("now put the load cell between the jaws")
        limits = [maximum * part for part in _FORCE_PARTS]
        return openings, measure_forces(gripper, limits, load_cell, notify)


def _range(options: argparse.Namespace, config: Any) -> tuple[float, float]:
    """Return the minimum and maximum opening, m, of the motion.

    Raises InputError if they are too close, or beyond the gripper's range.
    """
    minimum, maximum = config.opening
    low, high = (minimum + part * (maximum - minimum) for part in _OPENING_PARTS)
    if options.range:
        low, high = (1e-3 * value for value in options.range)
    if not minimum <= low < high - 5e-3 <= maximum:
        raise InputError(
            f"the openings {1e3 * low:g} and {1e3 * high:g} mm must be 5 mm apart and within "
            "the gripper's range",
            field="--opening-mm",
        )
    return low, high


def _force_max(options: argparse.Namespace, config: Any) -> float:
    """Return the maximum squeezing force, N. Raises InputError if the rig does not allow it."""
    maximum = 0.5 * config.force_max if options.force is None else options.force
    if not 0 < maximum <= config.force_max:
        raise InputError(
            f"{maximum:g} N is outside 0 to {config.force_max:g} N (force_max_N of the rig file)",
            field="--force-N",
        )
    return maximum


def _instruments(emulator: Any) -> tuple[Instrument, Instrument]:
    """Return the caliper, mm, and the load cell, N.

    The user reads them; on an emulated rig the emulated world provides them.
    """
    if emulator is None:
        return ask, ask
    return lambda _: 1e3 * emulator.truth()["opening"], lambda _: emulator.truth()["grip_force"]


def _lines(opening: Any, force: Any, servos: list[dict[str, Any]], refused: bool) -> list[str]:
    """Format the results as text."""
    lines = []
    if opening is not None:
        lines.append(
            f"opening: offset {1e3 * opening.offset:+.3f} mm at zero, scale "
            f"{opening.scale:.4f}, backlash {1e3 * opening.backlash:.3f} mm; residual "
            f"{1e3 * opening.rms:.3f} mm (rms)"
        )
    if force is not None:
        lines.append(
            f"force: {force.factor:.3f} times the value from the currents (sd "
            f"{force.factor_sd:.3f}), {force.offset:+.3f} N; residual {force.rms:.3f} N (rms)"
        )
    if not refused:
        lines.append("replaces these values of the rig file:")
        for servo in servos:
            lines.append("  [[gripper.servo]]")
            lines += [f"  {key} = {value}" for key, value in servo.items()]
    return lines
