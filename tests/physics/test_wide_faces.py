"""A plate wider than the frame moves nearly all markers alike, as a changed camera does. Its force
must not be taken for a camera drift or for gas."""

import numpy as np
import pytest

from mjtactile import load_sensor
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

DEPTHS = np.arange(0.5e-3, 2.8e-3, 0.25e-3)


def presses(sensor, *, gauge):
    """Ground truth force, N, and touch of a plate of 60 mm pressed in steps."""
    design = load_sensor(sensor)
    world = PressWorld(design, Indenter("box", 0.06))
    view = View(world, design, gauge=gauge)
    take_references(world, [view], design.chamber.supply_gauge)
    for depth in DEPTHS:
        world.press(depth)
        view.touch()
        yield -float(ground_truth.contact_force(world, 0)[2]), view.touch()


# The simulated mesh has 3 mm between vertices: its plate force is up to 7 % below that of a mesh of
# 25 x 21. Without a pressure sensor the markers alone determine the gas: 12 % for a plate over 16
# markers.
@pytest.mark.parametrize(
    ("sensor", "gauge", "error"),
    [
        ("paper16", True, 0.09),
        pytest.param("fine", True, 0.12, marks=pytest.mark.slow),
        pytest.param("dense", False, 0.16, marks=pytest.mark.slow),
        pytest.param("paper16", False, 0.14, marks=pytest.mark.slow),
    ],
)
def test_the_force_of_a_plate_is_not_absorbed(sensor, gauge, error):
    unknown = []
    for force, touch in presses(sensor, gauge=gauge):
        if touch.status != "ok":
            unknown.append(touch.status.code)
        else:
            assert touch.force_normal == pytest.approx(force, rel=error, abs=0.03)
            assert abs(touch.force_normal - force) < 4 * touch.force_normal_sd + 0.03 * force
    # 266 markers show the facets of the coarse mesh: the pressure sensor contradicts the estimate
    assert ("inconsistent" in unknown) is (sensor == "fine") and len(unknown) <= 5
