# pyright: reportMissingImports=false
"""`--robot.type=mjtactile`: a gripper with membrane touch sensors for LeRobot's own commands."""

from lerobot_robot_mjtactile.config_mjtactile import MjtactileRobotConfig
from lerobot_robot_mjtactile.robot import MjtactileRobot, latest

__all__ = ["MjtactileRobot", "MjtactileRobotConfig", "latest"]
