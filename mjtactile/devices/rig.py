"""Build a rig of real devices from a rig file. The emulated rig is the same, at the emulator's
addresses."""

from __future__ import annotations

import contextlib
import logging
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

from mjtactile.core import scaled_clock, signals
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.devices.dynamixel.gripper import DynamixelGripper
from mjtactile.devices.valve.driver import ValveBoard, connect_valves
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.rig.file import CameraConfig, GripperConfig, RigFile
from mjtactile.rig.finger import Rig, make_fingers
from mjtactile.rig.gripper_calibration import calibrated_gripper
from mjtactile.rig.protocols import CameraDevice
from mjtactile.rig.registry import CAMERAS, RigRequest, load_backend, require_file
from mjtactile.rig.sensors import finger_calibration, finger_design

_log = logging.getLogger(__name__)
_EMULATED = "/dev/pts/"  # folder of pseudo-terminals, which have no servos
# time slice of a thread in Python's interpreter, s: the default of 5 ms would delay an image's
# timestamp by that time
_SWITCH_INTERVAL = 5e-4


class MonotonicClock:
    """The computer's monotonic clock; a change of the wall clock has no effect."""

    def now(self) -> float:
        return scaled_clock.monotonic()

    def advance_towards(self, time: float) -> None:
        """Return at once: real time advances without calls."""

    def wait_until(self, time: float) -> None:
        _sleep_until(time)


class FrameClock(MonotonicClock):
    """Monotonic clock synchronized with the cameras.

    A cycle starts when an image arrives, not up to a period later.

    It wakes at the earliest half a period before the requested time. It wakes at the latest half a
    period after it, or a period after its last wake-up. The loop thus synchronizes with its
    cameras. It wakes even if they fail; `CameraDevice.read` detects their faults. It does not wait
    for a camera without `wait_newer` and `newest_time`, such as a third party's.
    """

    def __init__(self, cameras: Sequence[CameraDevice], period: float):
        self._cameras: list[Any] = [camera for camera in cameras if hasattr(camera, "wait_newer")]
        self._period = period
        self._seen = [0.0 for _ in self._cameras]
        self._woke = -math.inf

    def wait_until(self, time: float) -> None:
        half = self._period / 2
        latest = max(time, self._woke + self._period) + half
        _sleep_until(time - half)
        for i, camera in enumerate(self._cameras):
            camera.wait_newer(self._seen[i], max(0.0, latest - self.now()))
            self._seen[i] = camera.newest_time
        self._woke = self.now()


def _sleep_until(deadline: float) -> None:
    remaining = deadline - scaled_clock.monotonic()
    if remaining > 0:
        scaled_clock.sleep(remaining)


def build_device_rig(
    rig_file: RigFile,
    design: SensorDesign,
    *,
    name: str = "real",
    also_close: Callable[[], None] = lambda: None,
) -> Rig:
    """Connect every device of `rig_file`, all or none. `also_close` is called last when the rig is
    closed.

    Raises InputError when the file does not fit the sensor design, DeviceError naming the device
    that is missing.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    closers: list[Callable[[], None]] = [lambda: sys.setswitchinterval(before), also_close]
    try:
        designs = tuple(finger_design(camera, design) for camera in rig_file.cameras)
        calibrations = tuple(
            finger_calibration(*pair) for pair in zip(rig_file.cameras, designs, strict=True)
        )
        for camera, own in zip(rig_file.cameras, designs, strict=True):
            _check_image(camera, own, rig_file)
        cameras: list[CameraDevice] = []
        for camera in rig_file.cameras:
            signals.check()
            cameras.append(load_backend(CAMERAS, camera.backend)(camera))
            closers.append(getattr(cameras[-1], "close", lambda: None))
        signals.check()
        _check_pace(rig_file)
        boards, valves = connect_valves(rig_file.valves, rig_file.hold)
        closers.extend(board.close for board in boards)
        signals.check()
        config = calibrated_gripper(rig_file.gripper)
        gripper = DynamixelGripper(rig_file.bus, config, rig_file.lift, source=str(rig_file.path))
        closers.append(gripper.close)
    except BaseException:
        with contextlib.suppress(DeviceError):  # report the first fault only
            close_all(closers)
        raise
    names = tuple(camera.finger for camera in rig_file.cameras)
    return Rig(
        name=name,
        fingers=make_fingers(names, designs, tuple(cameras), tuple(valves), calibrations),
        gripper=gripper,
        clock=FrameClock(cameras, 1 / design.camera.rate),
        limits=_limits(rig_file, config, boards),
        close=lambda: close_all(closers),
        host_timeout=rig_file.bus.host_timeout,
    )


def _check_pace(rig_file: RigFile) -> None:
    if scaled_clock.slow() != 1 and not rig_file.bus.port.startswith(_EMULATED):
        raise InputError(
            f"{rig_file.bus.port}: only emulated devices can run slower",
            source=rig_file.path,
            field="--time-scale",
        )


def _limits(
    rig_file: RigFile, gripper: GripperConfig, boards: Sequence[ValveBoard]
) -> CommandLimits:
    """Return the limits of commands; without valves or pressure sensors there is no pressure."""
    has_sensors = boards and all(board.has_sensors for board in boards)
    highest = min((valve.pressure_max for valve in rig_file.valves), default=0.0)
    return CommandLimits(
        opening=gripper.opening,
        speed=gripper.speed_max,
        force=gripper.force_max,
        lift=(0.0, rig_file.lift.travel),
        lift_speed=rig_file.lift.speed,
        pressure=(0.0, highest) if has_sensors else None,
        pressure_rate=min((valve.pressure_rate for valve in rig_file.valves), default=0.0),
    )


def build(request: RigRequest) -> Rig:
    """Build the rig of the backend "devices" of `mjtactile.rig.registry`."""
    file = require_file(request)
    return build_device_rig(file, request.design, name=file.name)


def _check_image(camera: CameraConfig, design: SensorDesign, rig_file: RigFile) -> None:
    if (camera.width, camera.height) != (design.camera.width, design.camera.height):
        raise InputError(
            f"{camera.width} x {camera.height} pixels, but sensor {design.name!r} has "
            f"{design.camera.width} x {design.camera.height}",
            source=rig_file.path,
            field=f"camera.{camera.finger}.width_px",
        )


def close_all(closers: list[Callable[[], None]]) -> None:
    """Call every closer, last one first, even after failures. Then raise DeviceError with all
    failures.

    If another exception is already being raised, the failures are only logged.
    """
    failures = []
    in_transit = sys.exc_info()[0] is not None
    with signals.deferred():
        while closers:
            try:
                closers.pop()()
            except Exception as error:  # noqa: BLE001  # every device must get its turn
                failures.append(str(error))
                _log.error("%s", error)
    if failures and not in_transit:
        raise DeviceError("; ".join(failures))
