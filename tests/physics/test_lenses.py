"""The force does not depend on the lens: fisheye and rational polynomial against a pinhole."""

from dataclasses import replace
from functools import cache

import pytest

from mjtactile.core.design import load_sensor
from mjtactile.experiments import test_bench
from mjtactile.sim.scenes.indentation import Indenter

LENSES = {
    "pinhole": {"fx": 320.0, "distortion": ()},
    # 90 degrees over the width of 640 px: 407 atan(1) = 320 px
    "equidistant": {"fx": 407.0, "distortion": (0.02, -0.005, 0.0, 0.0)},
    "rational_polynomial": {"fx": 345.0, "distortion": (0.5, 0.1, 0, 0, 0.02, 0.9, 0.2, 0.05)},
}


@cache
def force(lens):
    """Return estimated and true force, N, of a sphere pressed 2.5 mm into a sensor whose camera has
    a field of view of 90 degrees."""
    design = load_sensor("dense")
    fields = LENSES[lens]
    model = "plumb_bob" if lens == "pinhole" else lens
    camera = replace(
        design.camera, distance=21e-3, fy=fields["fx"], distortion_model=model, **fields
    )
    design = replace(
        design,
        camera=camera,
        chamber=replace(design.chamber, depth=9e-3),
        glass=replace(design.glass, distance=9.5e-3),
    )
    assert not len(design.markers_outside_image())
    bench = test_bench.TestBench(design, Indenter.parse("sphere:8"), seed=1)
    bench.zero()
    bench.world.press(2.5e-3)
    return bench.measure(6)["force_N"], bench.load_cell()


@pytest.mark.parametrize("lens", ["equidistant", "rational_polynomial"])
def test_the_force_is_that_of_a_pinhole(lens):
    """The requirement is 3 % at 0.4 N. Image noise is 1 % of one image, 0.4 % of six; the fisheye
    shows the outer markers at half the size, with twice the noise."""
    pinhole, truth = force("pinhole")
    found, same = force(lens)
    assert same == pytest.approx(truth, rel=1e-12)  # the camera does not touch the membrane
    assert found == pytest.approx(pinhole, rel=0.03)
    assert found == pytest.approx(truth, rel=0.05)
