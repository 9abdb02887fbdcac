"""Tests of the paper's own force estimate, dF = c dA with a grid of springs.

It works within the range that the paper states, and not beyond.
"""

import numpy as np
import pytest

from benchmarks.paper.force_methods import spring_grid_force
from benchmarks.touch.area_force_constant import calibrate_area
from mjtactile.calibrate.force import AreaCalibration
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld


def test_fit_recovers_an_exact_constant_and_refuses_a_shrinking_area():
    dA = np.array([1e-6, 2e-6, 5e-6])
    calibration = AreaCalibration.fit(dA, 4e4 * dA)
    assert calibration.constant == pytest.approx(4e4) and calibration.residual < 1e-12
    with pytest.raises(InputError, match="area does not grow"):
        AreaCalibration.fit(-dA, 4e4 * dA)


def test_an_area_calibration_on_a_cylinder_estimates_its_force():
    design = load_sensor("dense")
    calibration = calibrate_area(design)
    # A sealed membrane's area initially grows with the square of depth. A line through it misses by
    # 0.1-0.25 N (measured; the paper's 0.04 N needs a larger initial load). Statics is therefore
    # the default.
    assert 2e4 < calibration.constant < 1e5 and 0.04 < calibration.residual < 0.25
    world = PressWorld(design, Indenter("cylinder", 5e-3))
    renderer = Renderer(design, seed=3)
    perception = StatefulPipeline.of(design)

    def image():
        return renderer.render(*world.marker_poses(0), world.time)

    world.inflate(0.0, seal=False)
    perception.measure_flat_reference([image() for _ in range(10)])
    world.inflate(design.chamber.supply_gauge, seal=True)
    perception.measure_rest_reference([image() for _ in range(10)], design.chamber.supply_gauge)
    rest = perception.state.reference.surface
    world.press(3e-3)
    surface = perception.perceive(image(), world.time).surface
    estimated = calibration.force(surface.area - rest.area)
    assert estimated == pytest.approx(-world.drive_force[2], abs=2 * calibration.residual)
    # the spring grid shows the force at the cylinder: the central third of the frame carries most
    # of it
    force = -spring_grid_force(surface, rest, design.membrane.pretension)[..., 2]
    in_x = np.abs(surface.x) < 0.0067
    in_y = np.abs(surface.y) < 0.0067
    central = in_x[None, :] & in_y[:, None]
    assert force[central].sum() > 0.5 * force[force > 0].sum()
