"""Camera of a simulated sensor, with the effects of a real camera."""

from __future__ import annotations

import numpy as np

from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.types import Image
from mjtactile.rig.as_built_sensor import NOMINAL, AsBuiltSensor, camera_pose, marker_radii
from mjtactile.sim.rendering.image_faults import FaultyImage
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.rendering.synthetic_ellipses import EllipseSampler
from mjtactile.sim.sensor.effect_switches import CAMERA, set_camera_effects
from mjtactile.sim.sensor.sensor_types import AnySensor

_EXPOSURE = 8e-3  # exposure time for motion blur, s
_SHUTTER = (0.0, 0.5, 1.0)  # fractions of the exposure at which the moving markers are rendered


class SimCamera:
    """Renderer of one sensor's image, on `read` or earlier by `capture`."""

    def __init__(
        self,
        sensor: AnySensor,
        seed: int,
        effects: frozenset[str] = CAMERA,
        as_built: AsBuiltSensor = NOMINAL,
    ):
        """Create the camera with the rendered `effects`.

        Without IMAGES, `read` gives a `SyntheticEllipses`. LATENCY returns the previous image,
        MOTION_BLUR averages over the exposure. `as_built` gives the true camera pose, the missing
        markers, and the image faults. Raises InputError for image faults without IMAGES, and
        without CHAIN.
        """
        if Effect.PIPELINE not in effects:
            raise InputError(
                "synthetic touch is available in grasps only", field="--effects -pipeline"
            )
        self._sensor = sensor
        self._faulty = FaultyImage(as_built.camera, seed)
        if self._faulty.has_faults and Effect.IMAGES not in effects:
            raise InputError(
                "image faults need images, and none are rendered", field="--effects -images"
            )
        design = set_camera_effects(sensor.design, effects)
        camera_options = {
            "pose": camera_pose(design, as_built),
            "radius": marker_radii(design, as_built),
        }
        self._sampler = (
            None
            if Effect.IMAGES in effects
            else EllipseSampler(design, seed=seed, **camera_options)
        )
        if self._sampler:
            self._renderer = None
        else:
            self._renderer = Renderer(
                design, seed=seed, shadows=Effect.SHADOWS in effects, **camera_options
            )
        self._moving = Effect.MOTION_BLUR in effects
        self._late = Effect.LATENCY in effects
        self._before: Image | None = None
        self._rendered: Image | None = None

    def reseed(self, seed: int) -> None:
        """Set a new seed for the image noise. An image already rendered is rendered again."""
        # one of them is there
        (self._sampler or self._renderer).reseed(seed)  # pyright: ignore[reportOptionalMemberAccess]
        self._faulty = FaultyImage(self._faulty.faults, seed)
        self._rendered = None

    def capture(self) -> None:
        """Render the current image of the membrane for `read`."""
        sensor = self._sensor
        if self._sampler is not None:
            mid_exposure = 0.5 * _EXPOSURE if self._moving else 0.0
            poses = (
                sensor.marker_poses_before(mid_exposure) if mid_exposure else sensor.marker_poses()
            )
            self._rendered = self._sampler.sample(*poses, sensor.time)
        else:
            renderer = self._renderer
            assert renderer is not None
            if self._moving:
                image = self._blurred(renderer)
            else:
                image = renderer.render(*sensor.marker_poses(), sensor.time)
            self._rendered = self._faulty(image)

    def read(self) -> Image:
        """Return the current image of the membrane, or the previous one of a late camera."""
        if self._rendered is None or self._rendered.time != self._sensor.time:
            self.capture()
        image = self._rendered
        self._rendered = None
        assert image is not None
        before = self._before
        self._before = image
        return before if self._late and before is not None else image

    def _blurred(self, renderer: Renderer) -> Image:
        """Return the mean image over the exposure that ends now."""
        poses = [self._sensor.marker_poses_before(fraction * _EXPOSURE) for fraction in _SHUTTER]
        gray = np.asarray(
            np.mean([renderer.irradiance_image(*pose) for pose in poses], axis=0, dtype=np.float32)
        )
        return renderer.expose(gray, self._sensor.time)
