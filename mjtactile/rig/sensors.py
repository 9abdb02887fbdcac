"""Sensor and calibration of each finger of a rig file."""

from __future__ import annotations

from collections.abc import Iterator

from mjtactile.core import foreign_file
from mjtactile.core.calibration import Calibration, PartState, load_calibration
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.rig.doctor_finding import Finding
from mjtactile.rig.file import CameraConfig, RigFile
from mjtactile.rig.gripper_calibration import gripper_state


def finger_design(finger: CameraConfig, default: SensorDesign) -> SensorDesign:
    """Return the sensor of a finger: its own file's, else `default`. Raises InputError for an
    invalid file."""
    return default if finger.sensor is None else load_sensor(finger.sensor)


def finger_calibration(finger: CameraConfig, design: SensorDesign) -> Calibration | None:
    """Return the calibration of a finger whose sensor is `design`.

    If the named file is missing, the calibration is empty. If no file is named, it is None. Raises
    InputError for a broken file, or one of another finger or sensor.
    """
    path = finger.calibration or design.calibration
    if path is None:
        return None
    if not foreign_file.exists(path):
        return Calibration(finger.finger, design.name)
    calibration = load_calibration(path)
    calibration.check(design, finger.finger, path)
    return calibration


def calibration_findings(rig_file: RigFile, default: SensorDesign) -> Iterator[Finding]:
    """Yield the findings of `mjtactile doctor` about a rig file's calibrations.

    Their states are missing, refused, outdated, good, or broken.
    """
    for camera in rig_file.cameras:
        yield from _finger_findings(rig_file, camera, default)
    try:
        state = gripper_state(rig_file.gripper)
        command = f"mjtactile calibrate gripper --rig {rig_file.path}"
        yield _finding("calibration of the gripper", state, command)
    except InputError as error:
        remedy = "repeat the calibration: `mjtactile calibrate gripper`"
        yield Finding("bad", "calibration of the gripper", str(error), remedy)


def _finger_findings(
    rig_file: RigFile, camera: CameraConfig, default: SensorDesign
) -> Iterator[Finding]:
    subject = f"calibration of {camera.finger}"
    try:
        design = finger_design(camera, default)
        calibration = finger_calibration(camera, design)
    except InputError as error:
        remedy = (
            "check that the file is complete and belongs to this finger and sensor, else "
            "repeat the calibration"
        )
        yield Finding("bad", subject, str(error), remedy)
        return
    if calibration is None:
        text = "the rig file names none: the values of the sensor file apply"
        line = f'calibration = "{camera.finger}.json"'
        remedy = f"add {line} to its [[camera]], then see `mjtactile calibrate --help`"
        yield Finding("warn", subject, text, remedy)
        return
    has_valve = any(valve.finger == camera.finger for valve in rig_file.valves)
    for state in calibration.states(design):
        if has_valve or state.kind != "valve":
            procedure = "camera" if state.kind == "lens" else state.kind
            options = f"--rig {rig_file.path} --finger {camera.finger}"
            command = f"mjtactile calibrate {procedure} {options}"
            yield _finding(f"{subject}, {state.kind}", state, command)


def _finding(subject: str, state: PartState, command: str) -> Finding:
    good = state.state == "good"
    missing = state.state == "missing"
    text = state.text if missing else f"{state.state}: {state.text}"
    return Finding("ok" if good else "warn", subject, text, "" if good else f"`{command}`")
