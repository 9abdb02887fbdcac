"""`mjtactile calibrate valve`: sensor zero, step response and leak of each chamber."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import InputError, load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate import output_options
from mjtactile.commands.calibrate.terminal import finish_all, notify
from mjtactile.commands.output import stdout_to_stderr

HELP = "pressure step: sensor zero, rise time, final pressure, leak"
DESCRIPTION = """\
Vent, open at a pressure, seal and vent again without contact on the membrane, and evaluate the
pressure sensor: zero and noise, rise time, final pressure, leak of the sealed chamber. Live on
each valve of a rig (--rig), or from a recording (SOURCE)."""
EPILOG = """\
examples:
  mjtactile calibrate valve --rig my_gripper.toml --pressure-kPa 1.0
  mjtactile calibrate valve --rig my_gripper.toml --finger left --seal 30
  mjtactile calibrate valve step.csv --pressure-kPa 1.0 --rig my_gripper.toml --finger left

SOURCE is a CSV file with the columns time_s, pressure_kPa (gauge) and state: vent, open,
closed, in this order, optionally vent again; at least 5 rows each, every 10 to 50 ms,
sealed for 2 s or (better) 30 s:
  time_s,pressure_kPa,state
  0.00,0.003,vent
  1.00,0.411,open
Writes the part `valve` of each finger's calibration file: offset_Pa, which is subtracted from
the pressures used for the force, and noise_sd_Pa, step_Pa, rise_time_s (10 to 90 %),
time_constant_s, leak_Pa_per_s with leak_sd_Pa_per_s, fall_time_s. Refused (exit code 1):
zero off by 5 % of the step, noise 5 %, final pressure off by 10 %, rise above 1 s, leak
above 10 % per minute.
"""

ARGUMENTS = (
    arg.positional(
        "source", "SOURCE.csv", "CSV file of a recorded pressure step", nargs="?", type=Path
    ),
    *output_options.arguments("its valves are stepped"),
    arg.option(
        "--pressure-kPa P",
        "gauge pressure of the step (default: the sensor's supply pressure)",
        dest="pressure",
        type=arg.POSITIVE,
    ),
    arg.option(
        "--seal S", "duration of the sealed stage (default: 10 s)", 10.0, type=arg.number(2)
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.result_io import stamp, stamp_of
    from mjtactile.calibrate.valve import valve_part

    if options.source is None and options.rig is None:
        message = "no recording is given: name it (SOURCE.csv), or add --rig to step its valves"
        raise InputError(message, field="SOURCE")
    targets = output_options.find_targets(options)
    with stdout_to_stderr():
        if options.source is None:
            fits = _live(options, targets)
        else:
            fits = [_recorded(options, targets[0])]
    results = {}
    for goal, fit in zip(targets, fits, strict=True):
        goal.write("valve", valve_part(fit, stamp_of(goal.design, fit.report())), fit.reasons)
        results[goal.finger] = goal.path, stamp("valve", fit.reasons) | fit.report(), [_line(fit)]
    return finish_all(options, results)


def _pressure(options: argparse.Namespace, goal: output_options.OutputFile) -> float:
    if options.pressure is None:
        return goal.design.chamber.supply_gauge
    return 1e3 * options.pressure


def _recorded(options: argparse.Namespace, goal: output_options.OutputFile) -> Any:
    from mjtactile.calibrate.result_io import read_columns
    from mjtactile.calibrate.valve import calibrate_valve

    table = read_columns(options.source, ("time_s", "pressure_kPa"), ("state",), fewest=15)
    try:
        return calibrate_valve(
            table["time_s"], 1e3 * table["pressure_kPa"], table["state"], _pressure(options, goal)
        )
    except InputError as error:
        raise InputError(str(error), source=options.source) from error


def _live(options: argparse.Namespace, targets: list[output_options.OutputFile]) -> list[Any]:
    from mjtactile.calibrate.connect import live_rig, live_valves
    from mjtactile.calibrate.interactive import calibrate_live_valve

    with (
        live_rig(options.rig, load_sensor(options.sensor)) as (rig_file, _),
        live_valves(rig_file) as of_finger,
    ):
        return [
            calibrate_live_valve(
                of_finger[goal.finger], _pressure(options, goal), options.seal, notify
            )
            for goal in targets
        ]


def _line(fit: Any) -> str:
    return (
        f"  zero {fit.offset:+.0f} Pa (noise {fit.noise_sd:.0f}), {fit.step:.0f} of "
        f"{fit.requested:.0f} Pa in {fit.rise_time:.3f} s (10 to 90 %), sealed leak "
        f"{fit.leak:+.2f} Pa/s (sd {fit.leak_sd:.2f})"
    )
