"""`mjtactile calibrate valve`: sensor zero, step response and leak of each chamber."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import Any

from mjtactile.commands.calibration import check_folder, finish, say
from mjtactile.commands.output import stdout_to_stderr
from mjtactile.errors import InputError

HELP = "pressure step: sensor zero, rise time, pressure reached, leak"
DESCRIPTION = """\
Vent, open at a pressure, seal, vent again, with nothing touching the membrane, and judge what the
pressure sensor says: its zero and noise, rise time, the pressure reached, the leak of the sealed
chamber. Live on each valve of a rig (--rig), or from a recording (SOURCE)."""
EPILOG = """\
examples:
  mjtactile calibrate valve --rig my_gripper.toml --pressure-kPa 1.0
  mjtactile calibrate valve --rig emulated --seal 3
  mjtactile calibrate valve step.csv --pressure-kPa 1.0 --out left_valve.json

SOURCE is a CSV file with the columns time_s, pressure_kPa (gauge) and state: vent, open, closed, in this order, and
perhaps vent again; at least 5 rows each, every 10 to 50 ms, sealed for 2 s or (better) 30 s:
  time_s,pressure_kPa,state
  0.00,0.003,vent
  1.00,0.411,open
Writes JSON: verdict, reasons, date, versions and for each valve offset_Pa, noise_sd_Pa, step_Pa, rise_time_s (10 to
90 %), time_constant_s, leak_Pa_per_s with leak_sd_Pa_per_s, fall_time_s.
Refused (exit code 1): zero off by 5 % of the step, noise 5 %, pressure reached off by 10 %, rise above 1 s, leak above
10 % a minute.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", nargs="?", type=Path, metavar="SOURCE.csv", help="a recorded step")
    parser.add_argument("--rig", metavar="NAME|FILE.toml", help="step the valves of this rig instead")
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml", help="gives the default pressure (default: dense)")
    parser.add_argument("--pressure-kPa", dest="pressure", type=float, metavar="P",
                        help="gauge pressure of the step (default: the sensor's supply pressure)")
    parser.add_argument("--seal", type=float, default=10.0, metavar="S", help="time to watch the sealed chamber (default: 10 s)")
    parser.add_argument("--out", type=Path, default=Path("valve.json"), metavar="FILE.json", help="default: valve.json")


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.valve import calibrate_valve
    from mjtactile.calibrate.verdict import read_columns, stamp, write
    from mjtactile.design import load_sensor

    if (options.source is None) == (options.rig is None):
        raise InputError("give either a recording (SOURCE.csv) or --rig", field="SOURCE")
    check_folder(options.out)
    design = load_sensor(options.sensor)
    pressure = design.chamber.supply_gauge if options.pressure is None else 1e3 * options.pressure
    if not pressure > 0 or not options.seal >= 2:
        raise InputError("--pressure-kPa must be above 0 and --seal at least 2 s", field="--pressure-kPa")
    with stdout_to_stderr():
        if options.rig:
            fits = _live(options, design, pressure)
        else:
            table = read_columns(options.source, ("time_s", "pressure_kPa"), ("state",), fewest=15)
            try:
                fits = {"recorded": calibrate_valve(table["time_s"], 1e3 * table["pressure_kPa"], table["state"], pressure)}
            except InputError as error:
                raise InputError(str(error), source=options.source) from error
    reasons = [f"{name}: {reason}" for name, fit in fits.items() for reason in fit.reasons]
    result: dict[str, Any] = stamp("valve", reasons) | {"valves": {name: fit.report() for name, fit in fits.items()}}
    path = write(options.out, result)
    return finish(options, path, result, [_line(name, fit) for name, fit in fits.items()])


def _live(options: argparse.Namespace, design, pressure: float) -> dict[str, Any]:
    from mjtactile.calibrate.live import calibrate_live_valve, live_rig
    from mjtactile.devices.valve import connect_valves

    with contextlib.ExitStack() as stack:
        rig_file, _ = stack.enter_context(live_rig(options.rig, design))
        if not rig_file.valves:
            raise InputError("the rig has no valve", source=rig_file.path, field="valve")
        boards, valves = connect_valves(rig_file.valves)
        for board in boards:
            stack.callback(board.close)
        return {valve.config.finger: calibrate_live_valve(valve, pressure, options.seal, say) for valve in valves}


def _line(name: str, fit) -> str:
    return (f"{name}: zero {fit.offset:+.0f} Pa (noise {fit.noise_sd:.0f}), {fit.step:.0f} of {fit.asked:.0f} Pa in "
            f"{fit.rise_time:.3f} s (10 to 90 %), sealed it loses {fit.leak:+.2f} Pa/s (sd {fit.leak_sd:.2f})")
