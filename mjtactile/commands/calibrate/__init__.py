"""`mjtactile calibrate WHAT`: calibrate a sensor or a rig once and store the result with
residuals."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate import camera, force, frame, gripper, valve

SIMULATES = False
KINDS = {"camera": camera, "valve": valve, "frame": frame, "force": force, "gripper": gripper}
DESCRIPTION = """\
Calibrate an as-built sensor or gripper. Each command writes its part, with residuals, date and
versions, into the calibration file of a finger, which the rig file names
([[camera]] calibration = "left.json"). grasp, probe, record and reconstruct use it; doctor
lists missing parts. A bad measurement is refused with the reason and replaces nothing.

Order for a new finger: camera (lens), valve, frame (flat membrane), force; gripper any time."""
EPILOG = """\
examples:
  mjtactile calibrate camera --print board.png             a board to print and glue to glass
  mjtactile calibrate camera --rig my_gripper.toml --finger left
  mjtactile calibrate valve --rig my_gripper.toml          both fingers
  mjtactile calibrate frame --rig my_gripper.toml
  mjtactile calibrate force --rig my_gripper.toml --load-cell
  mjtactile calibrate gripper --rig my_gripper.toml

`mjtactile calibrate WHAT --help` describes the procedure, the output and the limits;
docs/how-to/hardware.md has the full procedure with numbers. exit codes: 0 good, 1 measured but
refused, 2 bad input, 3 a device failed.
"""


@dataclass(frozen=True)
class _Kinds:
    """Subcommand for each kind of calibration."""

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        kinds = parser.add_subparsers(
            title="calibration procedures", metavar="PROCEDURE", dest="procedure", required=True
        )
        for name, kind in KINDS.items():
            sub = kinds.add_parser(
                name,
                help=kind.HELP,
                description=kind.DESCRIPTION,
                epilog=kind.EPILOG,
                formatter_class=argparse.RawDescriptionHelpFormatter,
            )
            arg.add(sub, kind.ARGUMENTS)
            arg.add(sub, _SHARED)


_SHARED = (
    arg.flag(
        "--json",
        "print one JSON object to stdout, all other output to stderr",
        default=argparse.SUPPRESS,
    ),
    arg.flag("--debug", "show the traceback of an error", default=argparse.SUPPRESS),
)
ARGUMENTS = (_Kinds(),)


def run(options: argparse.Namespace) -> int:
    return KINDS[options.procedure].run(options)
