"""Connections to the devices of a rig for a calibration, closed at its end."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.devices.camera.opencv import OpenCvCamera
from mjtactile.devices.dynamixel.gripper import DynamixelGripper
from mjtactile.devices.rig import build_device_rig
from mjtactile.devices.valve.driver import BoardValve, connect_valves
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.rig.file import RigFile, load_rig_file
from mjtactile.rig.finger import Rig


@contextlib.contextmanager
def live_rig(
    name: str, design: SensorDesign, *, object_name: str = "egg"
) -> Iterator[tuple[RigFile, EmulatorProcess | None]]:
    """Yield the rig file of `name` with addresses that accept connections.

    For an emulated rig, start the emulator and close it on exit.
    """
    rig_file = load_rig_file(name)
    if rig_file.emulator is None:
        yield rig_file, None
        return
    process = EmulatorProcess(rig_file, design, object_name=object_name)
    try:
        yield process.connect(rig_file), process
    finally:
        process.close()


@contextlib.contextmanager
def live_fingers(rig_file: RigFile, design: SensorDesign) -> Iterator[Rig]:
    """Yield the connected rig, with `design` on each finger without its own sensor file."""
    with contextlib.closing(build_device_rig(rig_file, design, name=rig_file.name)) as rig:
        yield rig


@contextlib.contextmanager
def live_camera(rig_file: RigFile, finger: str) -> Iterator[OpenCvCamera]:
    """Yield the connected camera of a finger. Raises InputError if the rig has none."""
    config = next((c for c in rig_file.cameras if c.finger == finger), None)
    if config is None:
        raise InputError(f"the rig has no {finger} camera", source=rig_file.path, field="--finger")
    with contextlib.closing(OpenCvCamera(config)) as camera:
        yield camera


@contextlib.contextmanager
def live_gripper(rig_file: RigFile) -> Iterator[DynamixelGripper]:
    """Connect the gripper and its lift, without compensation of its backlash."""
    config = replace(rig_file.gripper, backlash=0.0)
    gripper = DynamixelGripper(rig_file.bus, config, rig_file.lift, source=str(rig_file.path))
    with contextlib.closing(gripper):
        yield gripper


@contextlib.contextmanager
def live_valves(rig_file: RigFile) -> Iterator[dict[str, BoardValve]]:
    """Yield the connected valve of each finger. Raises InputError if the rig has none."""
    if not rig_file.valves:
        raise InputError("the rig has no valve", source=rig_file.path, field="valve")
    with contextlib.ExitStack() as stack:
        boards, valves = connect_valves(rig_file.valves)
        for board in boards:
            stack.callback(board.close)
        yield {valve.config.finger: valve for valve in valves}
