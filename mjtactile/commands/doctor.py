"""`mjtactile doctor`: check each device of a rig, and report problems with remedies."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.doctor import examine_rig

DESCRIPTION = """\
List cameras and serial ports. With --rig FILE, check each device of the file: connection,
model, settings, speed and errors. Nothing is changed and nothing moves; --fix corrects settings
that software can change (FTDI latency timer). Also list calibration parts that are missing,
refused, or older than the parts that they depend on.

Of a simulated rig, check the names in the file, the orientation of the fingertips, the motion
of the jaws against their transmissions, the lift, the force, and that no sensor touches its own
gripper."""
EPILOG = """\
examples:
  mjtactile doctor                        list connected devices
  mjtactile doctor --rig my_gripper.toml  compare them with the rig file
  mjtactile doctor --rig sim_arm          a simulated robot: docs/reference/rig_files.md
exit codes: 0 no faults, 1 faults found, 2 bad rig file.
"""
SIMULATES = False
_MARKS = {"ok": "ok  ", "warn": "warn", "bad": "BAD "}

ARGUMENTS = (
    arg.option("--rig NAME|FILE.toml", "rig file to check (default: only list connected devices)"),
    arg.sensor("sensor, if the rig file names none"),
    arg.flag("--fix", "correct settings that software can change"),
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
            print(f"{_MARKS[finding.level]}  {finding.subject}: {finding.text}")
            if finding.remedy:
                print(f"      -> {finding.remedy}")
    sys.stdout.flush()
    return 1 if any(f.level == "bad" for f in findings) else 0
