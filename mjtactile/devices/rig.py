"""Build a rig of real devices from a rig file. The emulated rig is the same, at the emulator's addresses."""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Callable, Sequence

from mjtactile.design import SensorDesign
from mjtactile.devices.dynamixel import DynamixelGripper
from mjtactile.devices.opencv_camera import OpenCvCamera
from mjtactile.devices.shutdown import close_all
from mjtactile.devices.valve import connect_valves
from mjtactile.errors import DeviceError, InputError
from mjtactile.rig import Limits, Rig
from mjtactile.rigfile import CameraConfig, RigFile

_SWITCH_INTERVAL = 5e-4  # s a thread keeps Python's interpreter: at the default of 5 ms a picture waits that long for its time


class MonotonicClock:
    """The computer's monotonic clock; a change of the wall clock does not touch it."""

    def now(self) -> float:
        return time.monotonic()

    def start(self, time: float) -> None:
        """The real world moves by itself."""

    def wait_until(self, time: float) -> None:
        _sleep_until(time)


class FrameClock(MonotonicClock):
    """The same, waking up with the cameras: a cycle begins when a picture has come, not up to a period later.

    It wakes from half a period before the time asked for to half a period after it, or after a period from its last
    waking: so the loop falls into step with its cameras. Whatever they do, it wakes: their faults are found by `Camera.read`.
    """

    def __init__(self, cameras: Sequence[OpenCvCamera], period: float):
        self._cameras, self._period = cameras, period
        self._seen = [0.0 for _ in cameras]
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
    remaining = deadline - time.monotonic()
    if remaining > 0:
        time.sleep(remaining)


def build_device_rig(rig_file: RigFile, design: SensorDesign, *, name: str = "real",
                     also_close: Callable[[], None] = lambda: None) -> Rig:
    """Connect every device of `rig_file`, all or none. `also_close` is called last when the rig is closed.

    Raises InputError when the file does not fit the sensor design, DeviceError naming the device that is missing.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    closers: list[Callable[[], None]] = [lambda: sys.setswitchinterval(before), also_close]
    try:
        for camera in rig_file.cameras:
            _check_picture(camera, design, rig_file)
        cameras = []
        for camera in rig_file.cameras:
            cameras.append(OpenCvCamera(camera))
            closers.append(cameras[-1].close)
        boards, valves = connect_valves(rig_file.valves)
        closers.extend(board.close for board in boards)
        gripper = DynamixelGripper(rig_file.bus, rig_file.gripper, rig_file.lift, source=str(rig_file.path))
        closers.append(gripper.close)
    except BaseException:
        with contextlib.suppress(DeviceError):  # the first trouble is the one to report
            close_all(closers)
        raise
    config = rig_file.gripper
    limits = Limits(opening=config.opening, speed=config.speed_max, force=config.force_max,
                    lift=(0.0, rig_file.lift.travel), lift_speed=rig_file.lift.speed)
    return Rig(name=name, design=design, cameras=tuple(cameras), valves=tuple(valves), gripper=gripper,
               clock=FrameClock(cameras, 1 / design.camera.rate), limits=limits, close=lambda: close_all(closers))


def _check_picture(camera: CameraConfig, design: SensorDesign, rig_file: RigFile) -> None:
    if (camera.width, camera.height) != (design.camera.width, design.camera.height):
        raise InputError(f"{camera.width} x {camera.height} pixels, but sensor {design.name!r} has {design.camera.width} x "
                         f"{design.camera.height}", source=rig_file.path, field=f"camera.{camera.finger}.width_px")
