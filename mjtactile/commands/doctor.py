"""`mjtactile doctor`: look at the devices of a rig, one by one, and say in plain words what is wrong and how to mend it."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from mjtactile.commands.output import print_json, stdout_to_stderr

HELP = "check cameras, servos and valves, and say how to mend what is wrong"
DESCRIPTION = """\
Look for cameras and serial ports; with --rig FILE, check each device that the file names: that it
answers, is the model that the file says, keeps its settings, is fast enough and has no error.
Nothing is changed and nothing moves; --fix mends what software can (FTDI latency timer)."""
EPILOG = """\
examples:
  mjtactile doctor                        what is plugged in
  mjtactile doctor --rig my_gripper.toml  is it what the file says
exit codes: 0 all well, 1 something is wrong, 2 bad rig file.
"""
SIMULATES = False
_MARKS = {"ok": "ok  ", "warn": "warn", "bad": "BAD "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rig", metavar="NAME|FILE.toml", help="rig file to check (default: only look what is plugged in)")
    parser.add_argument("--fix", action="store_true", help="mend what software can")


def run(options: argparse.Namespace) -> int:
    from mjtactile.devices.doctor import examine

    with stdout_to_stderr():
        findings = examine(options.rig, fix=options.fix)
    if options.json:
        report: dict[str, Any] = {"ok": all(f.level != "bad" for f in findings), "findings": [vars(f) for f in findings]}
        print_json(report)
    else:
        for finding in findings:
            print(f"{_MARKS[finding.level]}  {finding.what}: {finding.text}")
            if finding.remedy:
                print(f"      -> {finding.remedy}")
    sys.stdout.flush()
    return 1 if any(f.level == "bad" for f in findings) else 0
