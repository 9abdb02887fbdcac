"""`mjtactile doctor`: check the devices of a rig one by one, and report problems with remedies in
plain words."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.doctor import examine_rig

DESCRIPTION = """\
Look for cameras and serial ports; with --rig FILE, check each device that the file names: that it
answers, is the model that the file says, keeps its settings, is fast enough and has no error.
Nothing is changed and nothing moves; --fix mends what software can (FTDI latency timer). Of the
calibrations that it names: which parts are missing, refused, or older than what they rest on.

Of a simulated rig it checks the names in the file, which way the fingertips look, whether
the jaws go where their laws say and the hand rises, that no sensor touches its own gripper,
and the force."""
EPILOG = """\
examples:
  mjtactile doctor                        what is plugged in
  mjtactile doctor --rig my_gripper.toml  is it what the file says
  mjtactile doctor --rig sim_arm          a simulated robot: docs/reference/rig_files.md
exit codes: 0 all well, 1 something is wrong, 2 bad rig file.
"""
SIMULATES = False
_MARKS = {"ok": "ok  ", "warn": "warn", "bad": "BAD "}

ARGUMENTS = (
    arg.option(
        "--rig", "NAME|FILE.toml", "rig file to check (default: only look what is plugged in)"
    ),
    arg.sensor("the sensor, where the rig file does not say it"),
    arg.flag("--fix", "mend what software can"),
)


def run(options: argparse.Namespace) -> int:
    with stdout_to_stderr():
        findings = examine_rig(options.rig, sensor=options.sensor, fix=options.fix)
    if options.json:
        report: dict[str, Any] = {
            "ok": all(f.level != "bad" for f in findings),
            "findings": [vars(f) for f in findings],
        }
        print_json(report)
    else:
        for finding in findings:
            print(f"{_MARKS[finding.level]}  {finding.what}: {finding.text}")
            if finding.remedy:
                print(f"      -> {finding.remedy}")
    sys.stdout.flush()
    return 1 if any(f.level == "bad" for f in findings) else 0
