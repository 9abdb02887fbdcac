# pyright: reportMissingImports=false
"""Options of a camera `{type: mjtactile}`."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras import CameraConfig

import mjtactile


@CameraConfig.register_subclass("mjtactile")
@dataclass(kw_only=True)
class MjtactileCameraConfig(CameraConfig):
    """Settings of a finger camera. Size and rate are the rig file's, or the sensor's.

    Attributes:
        finger: Finger of the rig.
        rig: Rig file whose camera this process opens, for the finger of any LeRobot robot. "": the
            camera of the mjtactile robot in this process, simulated or real.
        sensor: Sensor on the fingers of that robot.
    """

    finger: str = "left"
    rig: str = ""
    sensor: str = "dense"

    def __post_init__(self) -> None:
        reported = self.device() if self.rig else mjtactile.load_sensor(self.sensor).camera
        self.width = self.width or reported.width
        self.height = self.height or reported.height
        self.fps = self.fps or round(reported.rate)

    def device(self):
        """Return the rig file's entry of this camera.

        Raises:
            ValueError: The rig file has no such finger.
        """
        cameras = mjtactile.load_rig_file(self.rig).cameras
        found = [camera for camera in cameras if camera.finger == self.finger]
        if not found:
            names = ", ".join(camera.finger for camera in cameras)
            raise ValueError(f"{self.rig} has no camera of finger {self.finger!r}: {names}")
        return found[0]
