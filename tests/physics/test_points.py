"""Contact follows the shape: edges, tips and faces that lie between the membrane's vertices."""

from pathlib import Path

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.sim import truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

MODELS = Path(__file__).parents[2] / "models" / "truth"
DEPTH = 2e-3


def pressed(indenter: Indenter, at: tuple[float, float], mesh: tuple[int, int]) -> float:
    world = PressWorld(load_sensor("dense"), indenter, at=at, mesh=mesh)
    world.inflate(1000.0, seal=True)
    world.press(DEPTH)
    return -float(truth.contact_force(world, 0)[2])


@pytest.mark.parametrize(("name", "reference"), [("wedge.xml", 0.390), ("cone.stl", 0.1198), ("corner.xml", 0.1211)])
def test_what_is_sharp_presses_between_vertices_too(name, reference):
    """Independent solver's forces (models/truth). 0.6 mm off the vertices, 25 % at 17 x 13: what was measured over places is up
    to 14 % (22 % midway between columns); with spheres that stay on their vertices it is -29 to -51 %."""
    indenter = Indenter.parse(str(MODELS / name))
    assert pressed(indenter, (-0.8e-3, 0.3e-3), (17, 13)) == pytest.approx(reference, rel=0.25)


def test_a_face_is_as_wide_as_it_is():
    """A face of 10 mm with edges between the vertices of 17 x 13, against 25 x 21: 12 %, since places differ by up to 9 %;
    with spheres that stay on their vertices it is 20 % low."""
    box = Indenter.parse("box:10")
    assert pressed(box, (1.1e-3, 0.7e-3), (17, 13)) == pytest.approx(pressed(box, (0.0, 0.0), (25, 21)), rel=0.12)


def test_round_things_stay_with_the_vertices():
    """A ball that the mesh resolves is none of this: no sphere moves."""
    world = PressWorld(load_sensor("dense"), Indenter.parse("sphere:8"))
    world.inflate(1000.0, seal=True)
    world.press(DEPTH)
    np.testing.assert_array_equal(world.model.geom_pos[world.sensors[0].vertex_geom_ids], 0.0)


def test_spheres_come_back():
    world = PressWorld(load_sensor("dense"), Indenter.parse("box:10"))
    world.inflate(1000.0, seal=True)
    world.press(DEPTH)
    places = world.model.geom_pos[world.sensors[0].vertex_geom_ids].copy()
    assert np.abs(places).max() > 5e-4  # edges are 1-1.7 mm from their vertices
    world.lift_off()
    world.step(100)
    # a membrane that falls asleep leaves them on the way
    assert np.abs(world.model.geom_pos[world.sensors[0].vertex_geom_ids]).max() < 1e-5
