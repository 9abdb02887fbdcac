"""`mjtactile calibrate WHAT`: measure what a sensor or a rig needs, once, and keep it with its residuals."""

from __future__ import annotations

import argparse

from mjtactile.commands import calibrate_camera, calibrate_force, calibrate_frame, calibrate_gripper, calibrate_valve

SIMULATES = False
KINDS = {"camera": calibrate_camera, "frame": calibrate_frame, "force": calibrate_force, "gripper": calibrate_gripper,
         "valve": calibrate_valve}  # fmt: skip
HELP = "calibrate camera, frame, force, gripper or valve, from live devices or recorded input"
DESCRIPTION = """\
Measure what the sensing chain or a rig file needs, and keep it in a file with residuals, date,
versions and a verdict. A bad calibration is refused with the reason; what was measured is then
kept beside it as NAME.refused.*, and a good file is never replaced by a bad one.

The order for a new finger: camera (lens), frame (flat membrane), valve, force; gripper any time."""
EPILOG = """\
examples:
  mjtactile calibrate camera --print board.png             a board to print and glue to glass
  mjtactile calibrate camera photos/ --out left.yaml
  mjtactile calibrate frame flat/ --sensor my_sensor.toml --out my_reference.json
  mjtactile calibrate force loads.csv --flat flat/ --rest rest/
  mjtactile calibrate gripper --rig my_gripper.toml
  mjtactile calibrate valve --rig emulated

`mjtactile calibrate WHAT --help` says what to do, what is written, and what is refused.
exit codes: 0 good, 1 measured but refused, 2 bad input, 3 a device failed.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = parser.add_subparsers(title="what to calibrate", metavar="WHAT", dest="what", required=True)
    for name, kind in KINDS.items():
        sub = kinds.add_parser(name, help=kind.HELP, description=kind.DESCRIPTION, epilog=kind.EPILOG,
                               formatter_class=argparse.RawDescriptionHelpFormatter)
        kind.add_arguments(sub)
        for flag, text in (("--json", "print one JSON object to stdout, all else to stderr"),
                           ("--debug", "show the traceback of an error")):
            sub.add_argument(flag, action="store_true", default=argparse.SUPPRESS, help=text)


def run(options: argparse.Namespace) -> int:
    return KINDS[options.what].run(options)

