"""Camera troubles: pure functions from picture to picture, one after the other.

    shown = FaultyImage(CameraFaults(gamma=1.3, jpeg=80), seed=1)
    image = shown(image)          # images of one camera, in their order

What each is and its range stand on the fields of `mjtactile.rig.camera_faults.CameraFaults`; what
is random (where dust lies, which picture tears) follows from the seed and the picture's number.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from mjtactile.core.types import Image
from mjtactile.rig.camera_faults import CameraFaults
from mjtactile.sim.rendering.image_faults import image_processing, image_sensor, optics
from mjtactile.sim.rendering.image_faults.fault_context import FaultContext, Floats, Step

STEPS: tuple[Step, ...] = (*optics.STEPS, *image_sensor.STEPS, *image_processing.STEPS)
"""In the order of light, chip, processor and wire."""
_FORGOTTEN = 0.15
"""s: a camera that is not read goes on taking pictures, of which the last is like the next."""
_DEFAULTS = {field.name: field.default for field in fields(CameraFaults)}


class FaultyImage:
    """The troubles of one camera, and what they keep from one picture to the next."""

    def __init__(self, troubles: CameraFaults, seed: int = 0):
        self.troubles = troubles
        self._seed = seed
        self._steps = [step for step in STEPS if is_on(step, troubles)]
        self._last: dict[str, tuple[float, Floats, Floats]] = {}
        self._number = 0

    @property
    def are_any(self) -> bool:
        """Whether it does anything to pictures."""
        return bool(self._steps)

    def __call__(self, image: Image) -> Image:
        """The picture as it arrives; the same where nothing is on yet."""
        if not self._steps or image.time < self.troubles.start:
            return image
        pixels = image.pixels.astype(np.float32)
        for step in self._steps:
            last = self._last.get(step.name)
            if last is not None and image.time - last[0] > _FORGOTTEN:
                last = None
            shot = FaultContext(self._seed, self._number, image.time, step.name, last)
            changed = step.apply(pixels, self.troubles, shot)
            self._last[step.name] = image.time, pixels, changed
            pixels = changed
        self._number += 1
        return Image(np.clip(np.rint(pixels), 0, 255).astype(np.uint8), image.time)


def is_on(step: Step, troubles: CameraFaults) -> bool:
    """Whether any of the step's switches is not at its default."""
    return any(getattr(troubles, name) != _DEFAULTS[name] for name in step.switches)
