# pyright: reportMissingImports=false
"""The camera of one finger as a LeRobot camera."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from lerobot.cameras import Camera
from lerobot_robot_mjtactile import latest_image

import mjtactile
from lerobot_camera_mjtactile.config_mjtactile import MjtactileCameraConfig
from mjtactile.rig.registry import CAMERAS, load_backend

_PAUSE = 1e-3  # polling interval of a driver that returns its newest image, s


class MjtactileCamera(Camera):
    """Camera of gray images of the membrane from inside, as (height, width, 3).

    `mjtactile` estimates touch from them, now or later from the data set.
    """

    def __init__(self, config: MjtactileCameraConfig):
        super().__init__(config)
        self.config = config
        self._driver: Any = None
        self._returned = -np.inf  # time stamp of the last image returned, s

    @property
    def is_connected(self) -> bool:
        return self._driver is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return no cameras: fingers are listed in rig files, devices by `mjtactile devices`."""
        return []

    def connect(self, warmup: bool = True) -> None:
        """Open the rig file's camera; the camera of a robot in this process is open already."""
        if self.is_connected:
            raise ConnectionError(f"the camera of finger {self.config.finger} is open")
        if not self.config.rig:
            self._driver = _OfRobot(self.config.finger)
            return
        device = self.config.device()
        self._driver = load_backend(CAMERAS, device.backend)(device)
        if warmup:
            self.read()

    def read(self) -> np.ndarray:
        """Return the newest image, gray levels (height, width, 3).

        Raises:
            ConnectionError: The camera is not open, or it has failed.
        """
        image = self._newest()
        self._returned = image.time
        return np.repeat(image.pixels[..., None], 3, axis=2)

    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """Wait for an image that was not returned yet, and return it.

        For a robot in this process it returns the newest image, since that robot's loop waits for
        it.

        Raises:
            ConnectionError: The camera is not open, or it has failed.
            TimeoutError: No new image arrived in that time.
        """
        until = time.perf_counter() + timeout_ms / 1e3
        while self.config.rig and self._newest().time <= self._returned:
            if time.perf_counter() > until:
                raise TimeoutError(f"no new image of finger {self.config.finger}")
            time.sleep(_PAUSE)
        return self.read()

    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        """Return the newest image; the driver never returns an old one.

        Raises:
            ConnectionError: The camera is not open, or it has failed.
        """
        return self.read()

    def disconnect(self) -> None:
        """Close the device."""
        driver, self._driver = self._driver, None
        close = getattr(driver, "close", lambda: None)
        close()

    def _newest(self) -> mjtactile.Image:
        if self._driver is None:
            raise ConnectionError(f"the camera of finger {self.config.finger} is not open")
        try:
            return self._driver.read()
        except mjtactile.DeviceError as error:
            raise ConnectionError(str(error)) from error


class _OfRobot:
    """Driver that returns the last image of a finger of this process's mjtactile robot."""

    def __init__(self, finger: str):
        self._finger = finger

    def read(self) -> mjtactile.Image:
        return latest_image(self._finger)
