"""Options that specify the calibrated finger, and the files that they name."""

from __future__ import annotations

import argparse

from mjtactile import InputError
from mjtactile.calibrate.output_file import OutputFile, camera_indices
from mjtactile.calibrate.output_file import find_targets as _find_targets
from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate.terminal import check_folder
from mjtactile.types import FINGERS

__all__ = ["OutputFile", "arguments", "camera_indices", "find_targets"]


def arguments(live: str, *, finger: str | None = None) -> tuple[arg.Argument, ...]:
    """Return the options that specify the calibrated finger. `live` describes the use of a rig
    without a SOURCE."""
    return (
        arg.option("--rig NAME|FILE.toml", f"rig of the finger; without SOURCE, {live}"),
        arg.choice(
            "--finger", FINGERS, f"finger of the rig (default: {finger or 'all of them'})", finger
        ),
        arg.sensor("sensor, if the rig file names none"),
        arg.out("calibration file to update (default: the one named in the rig file)", "FILE.json"),
    )


def find_targets(options: argparse.Namespace) -> list[OutputFile]:
    """Return the files that the options name; each is read once as a check. Raises InputError."""
    targets = _find_targets(options.rig, options.finger, options.sensor, options.out)
    if options.source is not None and len(targets) > 1:
        raise InputError("a recorded SOURCE belongs to one finger: name it", field="--finger")
    for goal in targets:
        check_folder(goal.path)
        goal.load()
    return targets
