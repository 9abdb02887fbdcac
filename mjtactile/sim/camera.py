"""A simulated sensor's camera: what it would see now, with the effects that a real one has."""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Image
from mjtactile.rig.specimen import NOMINAL, SpecimenConfig, camera_pose, marker_radii
from mjtactile.sim.picture.renderer import Renderer
from mjtactile.sim.sensor.runtime import TactileSensor
from mjtactile.sim.sensor.switches import CAMERA, Effect, set_picture

_EXPOSURE = 8e-3  # s, for motion blur
_SHUTTER = (0.0, 0.5, 1.0)  # shares of the exposure at which the moving markers are drawn


class SimCamera:
    """Renders one sensor's image when it is read, or before (`draw`), beside the work on the last one."""

    def __init__(self, sensor: TactileSensor, seed: int, effects: frozenset[str] = CAMERA,
                 specimen: SpecimenConfig = NOMINAL):
        """`effects`: what is drawn; LATENCY hands out the image before, MOTION_BLUR keeps the shutter open. `specimen` says
        where the camera really is, and which markers it does not see."""
        self._sensor = sensor
        design = set_picture(sensor.design, effects)
        self._renderer = Renderer(design, seed=seed, shadows=Effect.SHADOWS in effects, pose=camera_pose(design, specimen),
                                  radius=marker_radii(design, specimen))
        self._moving, self._late = Effect.MOTION_BLUR in effects, Effect.LATENCY in effects
        self._before: Image | None = None
        self._drawn: Image | None = None

    def reseed(self, seed: int) -> None:
        """Take the noise of the images to come from elsewhere; what was drawn already is drawn again."""
        self._renderer.reseed(seed)
        self._drawn = None

    def draw(self) -> None:
        """Have the image of the membrane now ready for `read`."""
        self._drawn = self._blurred() if self._moving else self._renderer.render(*self._sensor.marker_poses(), self._sensor.time)

    def read(self) -> Image:
        """The image of the membrane now."""
        if self._drawn is None or self._drawn.time != self._sensor.time:
            self.draw()
        image, self._drawn = self._drawn, None
        assert image is not None
        before, self._before = self._before, image
        return before if self._late and before is not None else image

    def _blurred(self) -> Image:
        """The mean of what the sensor sees over the exposure that ends now."""
        poses = [self._sensor.marker_poses_before(share * _EXPOSURE) for share in _SHUTTER]
        gray = np.asarray(np.mean([self._renderer.irradiance_image(*pose) for pose in poses], axis=0, dtype=np.float32))
        return self._renderer.expose(gray, self._sensor.time)
