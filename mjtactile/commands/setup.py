"""`mjtactile setup`: a rig file for the connected gripper, from questions to the user."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.core import resources

DESCRIPTION = """\
Write the rig file of a new gripper: find the servos, the valve board and the cameras, and ask
for their assignment ("press the membrane of the left finger") and for the limits. The file
starts as a copy of --template, whose comments explain the other settings (such as how a servo
angle moves its jaw). The file keeps its content and all answers: stop at any time and run it
again to continue. Nothing moves."""
EPILOG = """\
examples:
  mjtactile setup my_gripper.toml
  mjtactile setup my_gripper.toml --template one_xl330_linkage
afterwards:
  mjtactile doctor --rig my_gripper.toml             until it reports no fault
  mjtactile calibrate camera --help                  then valve, frame, force, gripper
"""
SIMULATES = False


ARGUMENTS = (
    arg.positional("file", "FILE.toml", "the rig file to create, or to continue", type=Path),
    arg.option("--template NAME|FILE.toml", "the rig file to start from", "two_xm430"),
    arg.repeated("--port PATH", "also check this port; may be repeated"),
    arg.repeated("--camera URL", "also check this stream; may be repeated"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.rig_wizard import setup

    def ask(question: str) -> str:
        try:
            return input(question)
        except EOFError as error:
            raise InputError(
                f"the input has ended; the results so far are in {options.file}: run it again "
                "to continue",
                field="stdin",
            ) from error

    with stdout_to_stderr():
        rig = setup(
            options.file,
            like=resources.find(options.template, "models/rigs", ".toml"),
            ports=options.port,
            cameras=options.camera,
            ask=ask,
            notify=print,
        )
    following = [
        f"mjtactile doctor --rig {options.file}",
        *(
            f"mjtactile calibrate {part} --rig {options.file}"
            for part in ("camera", "valve", "frame", "force", "gripper")
        ),
    ]
    if options.json:
        print_json({"file": options.file, "name": rig.name, "next": following})
    else:
        print(f"{options.file} is complete. Next:", *following, sep="\n  ")
    return 0
