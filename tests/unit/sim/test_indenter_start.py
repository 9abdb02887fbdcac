"""An indenter of any size starts clear of the inflated membrane, and the frame stops it."""

import math

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld


@pytest.mark.parametrize(
    ("kind", "size", "bottom"), [("sphere", 0.06, 0.06), ("sphere", 0.2, 0.2), ("box", 0.3, 0.15)]
)
def test_a_large_indenter_starts_without_contact(kind, size, bottom):
    world = PressWorld("dense", Indenter(kind, size))
    assert world.start_height > bottom
    assert not world.data.ncon
    assert world.inflate(world.design.chamber.supply_gauge, seal=True)
    assert not world.data.ncon
    # the first touch is at the top of the bulge
    top = float(world.sensors[0].p_SV[:, 2].max())
    assert world._touch_height + world.start_height - bottom == pytest.approx(top, abs=1e-3)
    world.press(0.5e-3)
    assert ground_truth.contact_force(world, 0)[2] < -0.05


def test_the_frame_stops_an_indenter_that_overlaps_it():
    """A ball over the rim used to sink through the frame, up to six times the membrane force."""
    radius = 4e-3
    aside = 2e-3  # of the ball's center, inside the frame's edge
    world = PressWorld("dense", Indenter("sphere", radius), at=(20e-3 - aside, 0.0))
    assert world.inflate(world.design.chamber.supply_gauge, seal=True)
    blocked = world.start_height + world._touch_height - math.sqrt(radius**2 - aside**2)
    for depth in (1e-3, 2e-3, 3e-3):
        world.press(depth)
    # the ball touches the edge of the frame; rigid, but for the contact's 0.1 mm
    assert world.depth == pytest.approx(blocked, abs=1e-4)
    force = ground_truth.contact_force(world, 0)
    assert 0.1 < -force[2] < 0.2  # 0.14 N at 1.5 mm, where it is free
    assert "frame_contact" in world.flags
    assert np.linalg.norm(world.drive_force) > 100  # 0.2 MN/m of the drive


def test_an_indenter_that_reaches_the_frame_first_is_refused():
    # the bulge of 2.6 mm is lower than the face tilted over the 23 mm to the outside of the frame
    world = PressWorld("dense", Indenter("box", 0.15), tilt=math.radians(15.0))
    world.inflate(world.design.chamber.supply_gauge, seal=True)
    with pytest.raises(InputError, match="touches the frame before the membrane"):
        world.press(0.5e-3)


def test_a_steady_load_is_settled_while_single_vertices_move():
    """Off center, vertices at the contact's edge keep moving at 0.4 mm/s; the force is steady."""
    world = PressWorld("dense", Indenter("sphere", 4e-3), at=(14e-3, 5e-3), mesh=(25, 21))
    world.inflate(world.design.chamber.supply_gauge, seal=True)
    assert world.press(3e-3)
    assert "unsettled" not in world.flags
    forces = []
    fastest = 0.0
    for _ in range(50):  # 0.2 s
        world.step()
        forces.append(ground_truth.contact_force(world, 0)[2])
        fastest = max(fastest, float(np.abs(world.data.qvel).max()))
    assert fastest > 2e-4  # the speed limit of a settled membrane
    assert np.ptp(forces) < 5e-3 * abs(np.mean(forces))
