"""The paper's force constant c (dF = c dA): press with a load cell behind the indenter, in 1 mm
increments."""

from __future__ import annotations

import numpy as np

from mjtactile.calibrate.force import AreaCalibration
from mjtactile.core.design import SensorDesign
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

CYLINDER = Indenter("cylinder", 5e-3)
DEPTHS = (1e-3, 2e-3, 3e-3, 4e-3)


def calibrate_area(
    design: SensorDesign,
    indenter: Indenter = CYLINDER,
    depths: tuple[float, ...] = DEPTHS,
    *,
    seed: int = 0,
) -> AreaCalibration:
    """Run the paper's experiment on the simulated sensor and fit c. The force is the load cell's,
    the area the camera's."""
    world = PressWorld(design, indenter)
    view = View(world, design, seed=seed)
    take_references(world, [view], design.chamber.supply_gauge)
    areas = []
    forces = []
    for depth in (0.0, *depths):
        world.press(depth)
        surfaces = [view.perception.perceive(image, world.time).surface for image in view.images()]
        areas.append(float(np.mean([surface.area for surface in surfaces if surface is not None])))
        forces.append(-float(world.drive_force[2]))
    return AreaCalibration.fit(np.array(areas[1:]) - areas[0], np.array(forces[1:]))
