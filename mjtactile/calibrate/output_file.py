"""Destination of a measured part: the finger's calibration file named in the rig file, or another
file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mjtactile.core import foreign_file
from mjtactile.core.calibration import Calibration, load_calibration
from mjtactile.core.calibration_parts import Part
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.types import FINGERS
from mjtactile.rig.file import CameraConfig, RigFile, load_rig_file
from mjtactile.rig.sensors import finger_design


@dataclass(frozen=True)
class OutputFile:
    """Calibration file `path` of one finger with the sensor file's `design`."""

    finger: str
    path: Path
    design: SensorDesign

    def load(self) -> Calibration:
        """Read the file; return an empty calibration if it does not exist. Raises InputError if it
        belongs to another finger or sensor."""
        if not foreign_file.exists(self.path):
            return Calibration(self.finger, self.design.name)
        calibration = load_calibration(self.path)
        calibration.check(self.design, self.finger, self.path)
        return calibration

    def write(self, kind: str, part: Part | None, reasons: Sequence[str]) -> None:
        """Write the part to the file; for a refused part, only the reasons."""
        before = self.load()
        if part is None or reasons:
            after = before.with_refusal(kind, reasons)
        else:
            after = before.with_part(part)
        after.save(self.path)


def find_targets(
    rig: str | None, finger: str | None, sensor: str, out: Path | None
) -> list[OutputFile]:
    """Return the files of the fingers of `rig` (all, or one `finger`), or the single file `out`.

    `sensor` applies to fingers without their own sensor file. Raises InputError, which names the
    options of `mjtactile calibrate`.
    """
    if rig is None:
        targets = [_output_file(out, finger or FINGERS[0], load_sensor(sensor))]
    else:
        rig_file = load_rig_file(rig)
        targets = [
            _target(out, rig_file, camera, load_sensor(sensor))
            for camera in _fingers_of(finger, rig_file)
        ]
    if out is not None and len(targets) > 1:
        raise InputError(
            "one output file is given for several fingers: add --finger", field="--out"
        )
    return targets


def _fingers_of(finger: str | None, rig_file: RigFile) -> list[CameraConfig]:
    """Return the selected fingers of the rig. Raises InputError if it has no such finger."""
    found = [camera for camera in rig_file.cameras if finger in (None, camera.finger)]
    if not found:
        raise InputError(
            f"the rig has no {finger} finger",
            source=rig_file.path,
            field="--finger",
            choices=[camera.finger for camera in rig_file.cameras],
        )
    return found


def camera_indices(targets: Sequence[OutputFile], rig_file: RigFile) -> list[int]:
    """Return the rig's camera index of each target's finger."""
    return [[camera.finger for camera in rig_file.cameras].index(goal.finger) for goal in targets]


def _target(
    out: Path | None, rig_file: RigFile, camera: CameraConfig, default: SensorDesign
) -> OutputFile:
    design = finger_design(camera, default)
    if out is not None:
        return _output_file(out, camera.finger, design)
    path = camera.calibration or design.calibration
    if path is None:
        index = rig_file.cameras.index(camera)
        message = (
            f"no calibration file is named for the {camera.finger} finger: write calibration "
            f'= "{camera.finger}.json" into this [[camera]] (of a copy, for a shipped rig), '
            "or add --out"
        )
        raise InputError(message, source=rig_file.path, field=f"camera[{index}].calibration")
    return OutputFile(camera.finger, path, design)


def _output_file(out: Path | None, finger: str, design: SensorDesign) -> OutputFile:
    if out is None:
        raise InputError(
            "the calibration needs a target: add --rig FILE.toml with --finger, or --out FILE.json",
            field="--rig",
        )
    return OutputFile(finger, out, design)
