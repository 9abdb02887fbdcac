"""`Station`: a simulated sensor on a stand, a drive with a load cell over it, and the chain that sees only its images."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjtactile.design import SensorDesign
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.sensing.squeeze import contact_face
from mjtactile.sim import truth
from mjtactile.sim.camera import Renderer
from mjtactile.sim.press import Indenter, PressWorld
from mjtactile.types import Image, Touch

_REFERENCE_IMAGES = 10


class Station:
    """One press experiment. `placing` goes to `PressWorld` (at, tilt, mesh)."""

    def __init__(self, design: SensorDesign, indenter: Indenter, *, seed: int = 0, **placing: Any):
        self.design = design
        self.world = PressWorld(design, indenter, **placing)
        self._renderer, self._pipeline = Renderer(design, seed=seed), SensorPipeline(design)
        self._rest_height = 0.0

    def zero(self, *, sealed: bool = True) -> None:
        """Take both references: flat with the valve open to the air, then inflated to the supply, sealed or not."""
        supply = self.design.chamber.supply_gauge
        self.world.inflate(0.0, seal=False)
        self._pipeline.take_flat([self.image() for _ in range(_REFERENCE_IMAGES)])
        self.world.inflate(supply, seal=sealed)
        self._pipeline.take_rest([self.image() for _ in range(_REFERENCE_IMAGES)], supply, sealed=sealed)
        surface = self.touch().surface
        self._rest_height = float(surface.z.max()) if surface is not None else 0.0

    def image(self) -> Image:
        """What the camera sees now."""
        return self._renderer.render(*self.world.marker_poses(0), self.world.time)

    def touch(self) -> Touch:
        """What the sensing chain makes of one image."""
        return self._pipeline.perceive(self.image(), self.world.time)

    def load_cell(self) -> float:
        """Normal force, N, that a load cell behind the indenter's face reads, also while the drive moves."""
        return -float(truth.contact_force(self.world, 0)[2])

    def look(self, images: int = 1) -> dict[str, float]:
        """Means over some images: normal force, area of the whole membrane, how far the contact is pressed in."""
        touches = [self.touch() for _ in range(images)]
        heights = [face[0] for touch in touches if (face := contact_face(touch)) is not None]
        areas = [touch.surface.area for touch in touches if touch.surface is not None]
        return {"force_N": float(np.mean([t.force_normal for t in touches])), "membrane_area_mm2": 1e6 * float(np.mean(areas)),
                "indentation_mm": 1e3 * (self._rest_height - float(np.mean(heights))) if heights else 0.0}
