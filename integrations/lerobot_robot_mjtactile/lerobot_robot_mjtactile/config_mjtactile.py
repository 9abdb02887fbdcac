# pyright: reportMissingImports=false
"""Options of `--robot.type=mjtactile`."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("mjtactile")
@dataclass(kw_only=True)
class MjtactileRobotConfig(RobotConfig):
    """As `mjtactile grasp` has them.

    Attributes:
        rig: "sim", a simulated rig's file, or a real one's.
        object: What stands there, of a simulation.
        sensor: What is on the fingers.
        seed: Of placement and noise, of a simulation.
        fingers: Their names, in the rig's order.
        images: Whether the fingers' images are observations, by the fingers' names.
        cameras: Others, of any type.
    """

    rig: str = "sim"
    object: str = "egg"
    sensor: str = "dense"
    seed: int = 0
    fingers: list[str] = field(default_factory=lambda: ["left", "right"])
    images: bool = True
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
