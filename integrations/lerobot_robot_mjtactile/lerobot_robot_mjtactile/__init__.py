# pyright: reportMissingImports=false
"""`--robot.type=mjtactile`: a gripper with membrane touch sensors for LeRobot's own commands."""

from lerobot_robot_mjtactile.config_mjtactile import MjtactileRobotConfig
from lerobot_robot_mjtactile.robot import MjtactileRobot, latest, latest_image

__all__ = ["MjtactileRobot", "MjtactileRobotConfig", "latest", "latest_image"]
