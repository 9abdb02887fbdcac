# pyright: reportMissingImports=false
"""A rig as a LeRobot robot: observations are touch estimates and images, actions are commands."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
from lerobot.cameras import make_cameras_from_configs
from lerobot.robots import Robot

import mjtactile
from lerobot_robot_mjtactile.config_mjtactile import MjtactileRobotConfig

ACTIONS = ("opening_m", "force_limit_N", "lift_height_m")
_latest: list[mjtactile.Observation] = []
_images: dict[str, mjtactile.Image] = {}


def latest() -> mjtactile.Observation:
    """Return the last observation of this process's robot.

    LeRobot passes no observation to a teleoperator.

    Raises:
        ConnectionError: No robot has an observation yet.
    """
    if not _latest:
        raise ConnectionError("no mjtactile robot has looked yet: --robot.type=mjtactile")
    return _latest[-1]


def latest_image(finger: str) -> mjtactile.Image:
    """Return the last image of a finger of this process's robot: for `{type: mjtactile}` cameras.

    Raises:
        ConnectionError: No robot has an image of such a finger.
    """
    if finger not in _images:
        names = ", ".join(_images) or "none: --robot.type=mjtactile, or name the camera's rig file"
        raise ConnectionError(f"no image of finger {finger!r}; there are {names}")
    return _images[finger]


class MjtactileRobot(Robot):
    """One session. A simulated world moves by one camera period for each action."""

    config_class = MjtactileRobotConfig
    name = "mjtactile"

    def __init__(self, config: MjtactileRobotConfig):
        super().__init__(config)
        self.config = config
        self.scenario = mjtactile.Scenario(
            rig=config.rig, object=config.object, sensor=config.sensor, seed=config.seed
        )
        self._others = make_cameras_from_configs(config.cameras)
        self._imaged = list(config.fingers) if config.images else []
        # LeRobot counts them, for its threads that write images
        self.cameras = dict.fromkeys(self._imaged) | self._others
        self._stack = ExitStack()
        self._steps: Any = None

    @property
    def observation_features(self) -> dict[str, type | tuple[int, int, int]]:
        """Features of mjtactile policies (`mjtactile.policy_observation_names`), and images of the
        fingers and the other cameras."""
        camera = self.scenario.design().camera
        names = mjtactile.policy_observation_names(len(self.config.fingers))
        images = dict.fromkeys(self._imaged, (camera.height, camera.width, 3))
        others = {name: (one.height, one.width, 3) for name, one in self._others.items()}
        return {**dict.fromkeys(names, float), **images, **others}

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(ACTIONS, float)

    @property
    def is_connected(self) -> bool:
        return self._steps is not None

    @property
    def is_calibrated(self) -> bool:
        """True: sensor calibrations are in the rig file, and references are taken on connecting."""
        return True

    def calibrate(self) -> None:
        """Do nothing: calibrations are made by `mjtactile calibrate`."""

    def configure(self) -> None:
        """Do nothing."""

    def connect(self, calibrate: bool = True) -> None:
        """Open the rig and take the references of each sensor; no object may touch them."""
        session = self._stack.enter_context(mjtactile.open_session(self.scenario, workers=0))
        names = [finger.name for finger in session.rig.fingers]
        if names != list(self.config.fingers):
            self._stack.close()
            raise ValueError(f"the rig's fingers are {names}: --robot.fingers='{names}'")
        session.take_references()
        self._steps = self._stack.enter_context(session.steps())
        for camera in self._others.values():
            camera.connect()
            self._stack.callback(camera.disconnect)

    def disconnect(self) -> None:
        """Bring the rig to its safe state."""
        self._steps = None
        _latest.clear()
        _images.clear()
        self._stack.close()

    def get_observation(self) -> dict[str, Any]:
        """Wait for the next images, and estimate touch from them."""
        observation = self._steps.observe()
        _latest[:] = [observation]
        _images.update(zip(self.config.fingers, self._steps.images, strict=True))
        names = mjtactile.policy_observation_names(len(self.config.fingers))
        values = mjtactile.policy_observation(observation)
        found: dict[str, Any] = dict(zip(names, map(float, values), strict=True))
        for finger in self._imaged:
            found[finger] = np.repeat(_images[finger].pixels[..., None], 3, axis=2)
        for name, camera in self._others.items():
            found[name] = camera.async_read()
        return found

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Request an opening, a force limit and a height; the rig's limits apply."""
        requested = mjtactile.Command(
            opening=float(action["opening_m"]),
            force_limit=float(action["force_limit_N"]),
            lift_height=float(action["lift_height_m"]),
            phase="regulate",
        )
        sent = self._steps.send(requested)
        return dict(zip(ACTIONS, (sent.opening, sent.force_limit, sent.lift_height), strict=True))
