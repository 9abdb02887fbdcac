"""The paper's force constant c (dF = c dA): press with a load cell behind the indenter, in 1 mm increments."""

from __future__ import annotations

import numpy as np

from mjtactile.design import SensorDesign
from mjtactile.sensing.force import AreaCalibration
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.sim.camera import Renderer
from mjtactile.sim.press import Indenter, PressWorld

CYLINDER = Indenter("cylinder", 5e-3)
DEPTHS = (1e-3, 2e-3, 3e-3, 4e-3)
_IMAGES = 10


def calibrate_area(design: SensorDesign, indenter: Indenter = CYLINDER, depths: tuple[float, ...] = DEPTHS, *,
                   seed: int = 0) -> AreaCalibration:
    """Run the paper's experiment on the simulated sensor and fit c. The force is the load cell's, the area the camera's."""
    world, renderer, pipeline = PressWorld(design, indenter), Renderer(design, seed=seed), SensorPipeline(design)

    def images() -> list:
        return [renderer.render(*world.marker_poses(0), world.time) for _ in range(_IMAGES)]

    world.inflate(0.0, seal=False)
    pipeline.take_flat(images())
    world.inflate(design.chamber.supply_gauge, seal=True)
    pipeline.take_rest(images(), design.chamber.supply_gauge)
    areas, forces = [], []
    for depth in (0.0, *depths):
        world.press(depth)
        seen = [pipeline.perceive(image, world.time).surface for image in images()]
        areas.append(float(np.mean([surface.area for surface in seen if surface is not None])))
        forces.append(-float(world.drive_force[2]))
    return AreaCalibration.fit(np.array(areas[1:]) - areas[0], np.array(forces[1:]))
