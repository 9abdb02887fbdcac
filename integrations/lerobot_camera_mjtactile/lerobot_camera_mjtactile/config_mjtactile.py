# pyright: reportMissingImports=false
"""Options of a camera `{type: mjtactile}`."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras import CameraConfig

import mjtactile


@CameraConfig.register_subclass("mjtactile")
@dataclass(kw_only=True)
class MjtactileCameraConfig(CameraConfig):
    """Whose picture. Size and rate are the rig file's, or the sensor's.

    Attributes:
        finger: Of the rig.
        rig: A rig file, whose camera this process opens: the finger of any LeRobot robot. "": that
            of the mjtactile robot in this process, simulated or real.
        sensor: What is on the fingers of that robot.
    """

    finger: str = "left"
    rig: str = ""
    sensor: str = "dense"

    def __post_init__(self) -> None:
        said = self.device() if self.rig else mjtactile.load_sensor(self.sensor).camera
        self.width = self.width or said.width
        self.height = self.height or said.height
        self.fps = self.fps or round(said.rate)

    def device(self):
        """What the rig file says of this camera.

        Raises:
            ValueError: It has no such finger.
        """
        cameras = mjtactile.load_rig_file(self.rig).cameras
        found = [camera for camera in cameras if camera.finger == self.finger]
        if not found:
            names = ", ".join(camera.finger for camera in cameras)
            raise ValueError(f"{self.rig} has no camera of finger {self.finger!r}: {names}")
        return found[0]
