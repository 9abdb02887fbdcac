# pyright: reportMissingImports=false
"""`--teleop.type=mjtactile`: a controller file in place of a person."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot_robot_mjtactile import latest

import mjtactile


@TeleoperatorConfig.register_subclass("mjtactile")
@dataclass(kw_only=True)
class MjtactileTeleoperatorConfig(TeleoperatorConfig):
    """Controller to run: a shipped name, or FILE.py."""

    controller: str = "adaptive"


class MjtactileTeleoperator(Teleoperator):
    """Teleoperator that returns the controller's command for the robot's last observation."""

    config_class = MjtactileTeleoperatorConfig
    name = "mjtactile"

    def __init__(self, config: MjtactileTeleoperatorConfig):
        super().__init__(config)
        self.config = config
        self._controller: Any = None
        self._last: mjtactile.Command | None = None

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(("opening_m", "force_limit_N", "lift_height_m"), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._controller is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def connect(self, calibrate: bool = True) -> None:
        """Read the controller's file."""
        self._controller = mjtactile.load_controller(self.config.controller)

    def disconnect(self) -> None:
        """Discard the controller."""
        self._controller = None
        self._last = None

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing."""

    def get_action(self) -> dict[str, float]:
        """Return the controller's next command; once it is done, its last one."""
        seen = latest()
        last = self._last
        if last is None or last.phase not in ("done", "abort"):
            if last is not None:  # separate memory, which the robot does not return
                kept = replace(seen.command, phase=last.phase, memory=last.memory)
                seen = replace(seen, command=kept)
            self._last = last = self._controller.step(seen)
        if last.force_limit is None:
            raise ValueError("the controller's command has no force_limit, which an action needs")
        return {
            "opening_m": last.opening,
            "force_limit_N": last.force_limit,
            "lift_height_m": last.lift_height,
        }
