"""Where a measured part goes: into the calibration file of a finger, which the rig file names, or `--out`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mjtactile.commands.calibrate.terminal import check_folder
from mjtactile.core.calibration import Calibration, Part, load_calibration
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.types import FINGERS
from mjtactile.rig.file import CameraConfig, RigFile, load_rig_file
from mjtactile.rig.sensors import finger_design


@dataclass(frozen=True)
class Target:
    """The calibration file `path` of one finger, whose sensor file says `design`."""

    finger: str
    path: Path
    design: SensorDesign

    def load(self) -> Calibration:
        """What is in the file; nothing where it is not there yet. Raises InputError for one of something else."""
        if not self.path.exists():
            return Calibration(self.finger, self.design.name)
        calibration = load_calibration(self.path)
        calibration.check(self.design, self.finger, self.path)
        return calibration

    def write(self, kind: str, part: Part | None, reasons: Sequence[str]) -> None:
        """Put the part into the file; where there are reasons to refuse it, only them."""
        before = self.load()
        (before.with_refusal(kind, reasons) if part is None or reasons else before.with_part(part)).save(self.path)


def add_arguments(parser: argparse.ArgumentParser, live: str, *, finger: str | None = None) -> None:
    """Options that say whose calibration it is; `live` says what is done with a rig when there is no SOURCE."""
    parser.add_argument("--rig", metavar="NAME|FILE.toml", help=f"whose finger it is; without SOURCE, {live}")
    parser.add_argument("--finger", choices=FINGERS, default=finger,
                        help=f"which finger of the rig (default: {finger or 'all of them'})")
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml",
                        help="the sensor, where the rig file does not say it (default: dense)")
    parser.add_argument("--out", type=Path, metavar="FILE.json",
                        help="calibration file to write into (default: the one that the rig file names)")


def find_targets(options: argparse.Namespace) -> list[Target]:
    """The files that the options name, each read once to see that it fits. Raises InputError."""
    if options.rig is None:
        targets = [_out(options, options.finger or FINGERS[0], load_sensor(options.sensor))]
    else:
        rig_file = load_rig_file(options.rig)
        targets = [_target(options, rig_file, camera) for camera in fingers_of(options, rig_file)]
    if options.out is not None and len(targets) > 1:
        raise InputError("one file for several fingers: give --finger too", field="--out")
    for target in targets:
        check_folder(target.path)
        target.load()
    return targets


def fingers_of(options: argparse.Namespace, rig_file: RigFile) -> list[CameraConfig]:
    """The fingers of the rig that are meant. Raises InputError when it has no such finger."""
    found = [camera for camera in rig_file.cameras if options.finger in (None, camera.finger)]
    if not found:
        raise InputError(f"the rig has no {options.finger} finger", source=rig_file.path, field="--finger",
                         choices=[camera.finger for camera in rig_file.cameras])
    return found


def places(targets: Sequence[Target], rig_file: RigFile) -> list[int]:
    """Which camera of the rig each target's finger has."""
    return [[camera.finger for camera in rig_file.cameras].index(goal.finger) for goal in targets]


def _target(options: argparse.Namespace, rig_file: RigFile, camera: CameraConfig) -> Target:
    design = finger_design(camera, load_sensor(options.sensor))
    if options.out is not None:
        return _out(options, camera.finger, design)
    path = camera.calibration or design.calibration
    if path is None:
        number = rig_file.cameras.index(camera)
        raise InputError(f'names no file for the {camera.finger} finger: write calibration = "{camera.finger}.json" into this '
                         "[[camera]] (of a copy, if the rig is a shipped one), or give --out", source=rig_file.path,
                         field=f"camera[{number}].calibration")
    return Target(camera.finger, path, design)


def _out(options: argparse.Namespace, finger: str, design: SensorDesign) -> Target:
    if options.out is None:
        raise InputError("whose calibration is it? Give --rig FILE.toml with --finger, or --out FILE.json", field="--rig")
    return Target(finger, options.out, design)
