"""The emulated rig: the emulator's process, connected to the drivers of the real devices."""

from __future__ import annotations

from dataclasses import replace

from mjtactile.core.design import SensorDesign
from mjtactile.devices.rig import build_device_rig
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.rig.file import RigFile
from mjtactile.rig.finger import Rig
from mjtactile.rig.registry import RigRequest, require_file


def build_emulated_rig(
    rig_file: RigFile,
    design: SensorDesign,
    *,
    object_name: str,
    seed: int,
    emulator: EmulatorProcess | None = None,
) -> Rig:
    """Start the emulator (or use the one given, which stays running) and connect to it.

    Raises InputError for bad names or files, DeviceError when a device does not answer.
    """
    process = emulator or EmulatorProcess(rig_file, design, object_name=object_name, seed=seed)
    also_close = process.close if emulator is None else lambda: None
    rig = build_device_rig(
        process.connect(rig_file), design, name=rig_file.name, also_close=also_close
    )
    return replace(rig, truth=process.truth, simulated=process.endpoints["simulated"])


def build(request: RigRequest) -> Rig:
    """Build the rig of the backend "emulator" of `mjtactile.rig.registry`."""
    return build_emulated_rig(
        require_file(request),
        request.design,
        object_name=request.scenario.object,
        seed=request.scenario.seed,
    )
