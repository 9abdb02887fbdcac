"""Measured values of `calibrate gripper`, which replace those of the rig file."""

from __future__ import annotations

import hashlib
from dataclasses import replace

from mjtactile.core import foreign_file
from mjtactile.core.calibration import PartState
from mjtactile.core.config_fields import MM, entries
from mjtactile.core.toml import Section, read_json
from mjtactile.rig.file import GripperConfig, ServoConfig

_SERVO = entries(ServoConfig)
_MEASURED = ("zero_ticks", "per_rad", "torque_per_A")


def gripper_fingerprint(config: GripperConfig) -> str:
    """Return the SHA-256 of the servo settings in the rig file."""
    return hashlib.sha256(repr(config.servos).encode()).hexdigest()


def calibrated_gripper(config: GripperConfig) -> GripperConfig:
    """Return the configuration with measured servo values and backlash.

    They come from the calibration file that the rig file names. Without that file, or if it is for
    another gripper configuration (fingerprint), `config` is returned unchanged.

    Raises InputError if the file is broken or belongs to other servos.
    """
    table = _read(config)
    if table is None or table.text("fingerprint") != gripper_fingerprint(config):
        return config
    lines = {_SERVO["id"].read(line, ...): line for line in table.sections("servo", 1, 8)}
    ids = [servo.id for servo in config.servos]
    if sorted(lines) != sorted(ids):
        raise table.fail(
            "servo", f"is for servos {sorted(lines)}, but the rig file has {sorted(ids)}"
        )
    opening = table.optional("opening")
    backlash = config.backlash
    if opening is not None:
        backlash = max(0.0, opening.number("backlash_mm", -5, 5, MM))
    servos = tuple(_servo(servo, lines[servo.id]) for servo in config.servos)
    return replace(config, servos=servos, backlash=backlash)


def gripper_state(config: GripperConfig) -> PartState:
    """Return the state of the gripper's calibration, for `mjtactile doctor`."""
    table = _read(config)
    if table is None:
        path = config.calibration
        where = "the rig file names none" if path is None else f"{path} does not exist"
        text = f"never measured ({where}): the values of the rig file apply"
        return PartState("gripper", "missing", text)
    date = table.text("date")[:10]
    if table.text("fingerprint") == gripper_fingerprint(config):
        return PartState("gripper", "good", f"of {date}")
    text = f"of {date}, not used: the servos in the rig file have changed since"
    return PartState("gripper", "outdated", text)


def _read(config: GripperConfig) -> Section | None:
    path = config.calibration
    if path is None or not foreign_file.exists(path):
        return None
    table = read_json(path)
    section = Section(table if isinstance(table, dict) else {}, "", str(path))
    section.text("calibration", ["gripper"])
    return section


def _servo(servo: ServoConfig, line: Section) -> ServoConfig:
    """Return the servo with the measured values of the line in place of the rig file's."""
    values = {name: _SERVO[name].read(line, getattr(servo, name)) for name in _MEASURED}
    line.done()
    return replace(servo, **values)
