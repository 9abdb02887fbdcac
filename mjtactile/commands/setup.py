"""`mjtactile setup`: a rig file for the gripper on the table, by questions."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.core import resources

DESCRIPTION = """\
Make the rig file of a new gripper: find the servos, the valve board and the cameras, ask which is
which ("press the membrane of the left finger"), and for its limits. The file begins as a copy of
--template, whose comments say the rest (how a servo's angle moves its jaw, for one). What is in the
file and answers is kept: stop whenever you like and run it again, it goes on. Nothing moves."""
EPILOG = """\
examples:
  mjtactile setup my_gripper.toml
  mjtactile setup my_gripper.toml --template one_xl330_linkage
afterwards:
  mjtactile doctor --rig my_gripper.toml             until nothing is bad
  mjtactile calibrate camera --help                  and then valve, frame, force, gripper
"""
SIMULATES = False


ARGUMENTS = (
    arg.positional("file", "FILE.toml", "the rig file to make, or to go on with", type=Path),
    arg.option("--template", "NAME|FILE.toml", "the rig file that it begins as", "two_xm430"),
    arg.repeated("--port", "PATH", "also look at this port; again for more"),
    arg.repeated("--camera", "URL", "also look at this stream; again for more"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.rig_wizard import setup

    def ask(question: str) -> str:
        try:
            return input(question)
        except EOFError as error:
            raise InputError(
                f"no more answers; what was found until now is in {options.file}: run it again "
                "to go on",
                field="stdin",
            ) from error

    with stdout_to_stderr():
        rig = setup(
            options.file,
            like=resources.find(options.template, "models/rigs", ".toml"),
            ports=options.port,
            cameras=options.camera,
            ask=ask,
            say=print,
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
