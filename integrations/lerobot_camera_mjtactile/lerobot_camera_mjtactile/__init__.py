# pyright: reportMissingImports=false
"""`{type: mjtactile}` among a LeRobot robot's cameras: the image of one finger's membrane."""

from lerobot_camera_mjtactile.camera import MjtactileCamera
from lerobot_camera_mjtactile.config_mjtactile import MjtactileCameraConfig

__all__ = ["MjtactileCamera", "MjtactileCameraConfig"]
