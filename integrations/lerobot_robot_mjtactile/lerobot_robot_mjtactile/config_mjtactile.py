# pyright: reportMissingImports=false
"""Options of `--robot.type=mjtactile`."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("mjtactile")
@dataclass(kw_only=True)
class MjtactileRobotConfig(RobotConfig):
    """Options of the robot, as in `mjtactile grasp`.

    Attributes:
        rig: "sim", a simulated rig's file, or a real one's.
        object: Object in the simulation.
        sensor: Sensor on the fingers.
        seed: Seed of placement and noise, in simulation.
        fingers: Names of the fingers, in the rig's order.
        images: True to observe the fingers' images, by the fingers' names.
        cameras: Additional cameras, of any type.
    """

    rig: str = "sim"
    object: str = "egg"
    sensor: str = "dense"
    seed: int = 0
    fingers: list[str] = field(default_factory=lambda: ["left", "right"])
    images: bool = True
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
