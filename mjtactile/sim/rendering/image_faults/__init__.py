"""Camera faults: pure functions from image to image, applied one after the other.

The fields of `mjtactile.rig.camera_faults.CameraFaults` give the meaning and range of each fault.
Random choices (position of dust, torn images) follow from the seed and the image number.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from mjtactile.core.types import Image
from mjtactile.rig.camera_faults import CameraFaults
from mjtactile.sim.rendering.image_faults import electronics, optics
from mjtactile.sim.rendering.image_faults.optics import FaultContext, Floats, Step

STEPS: tuple[Step, ...] = (*optics.STEPS, *electronics.STEPS)
"""In the order of light, chip, processor and wire."""
_FORGOTTEN = 0.15
"""Time after which the last image is discarded, s."""
_DEFAULTS = {field.name: field.default for field in fields(CameraFaults)}


class FaultyImage:
    """Faults of one camera, and their state from one image to the next."""

    def __init__(self, faults: CameraFaults, seed: int = 0):
        self.faults = faults
        self._seed = seed
        self._steps = [step for step in STEPS if is_on(step, faults)]
        self._last: dict[str, tuple[float, Floats, Floats]] = {}
        self._number = 0

    @property
    def has_faults(self) -> bool:
        """True if any fault is enabled."""
        return bool(self._steps)

    def __call__(self, image: Image) -> Image:
        """Return the image with the faults; unchanged before the faults start."""
        if not self._steps or image.time < self.faults.start:
            return image
        pixels = image.pixels.astype(np.float32)
        for step in self._steps:
            last = self._last.get(step.name)
            if last is not None and image.time - last[0] > _FORGOTTEN:
                last = None
            shot = FaultContext(self._seed, self._number, image.time, step.name, last)
            changed = step.apply(pixels, self.faults, shot)
            self._last[step.name] = image.time, pixels, changed
            pixels = changed
        self._number += 1
        return Image(np.clip(np.rint(pixels), 0, 255).astype(np.uint8), image.time)


def is_on(step: Step, faults: CameraFaults) -> bool:
    """Return True if any of the step's switches differs from its default."""
    return any(getattr(faults, name) != _DEFAULTS[name] for name in step.switches)
