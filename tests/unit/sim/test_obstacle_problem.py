"""Heights of a membrane on an obstacle against equilibrium, and the true contact area from them."""

import numpy as np
import pytest

from mjtactile.sim import ground_truth
from mjtactile.sim.obstacle_problem import solve_contact
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

PRESSURE = 1200.0
TENSION = 45.0
SIDES = (0.04, 0.03)
AT = (1.7e-3, -0.9e-3)


def grid(spacing):
    x, y = np.meshgrid(
        *(np.linspace(-side / 2, side / 2, round(side / spacing) + 1) for side in SIDES),
        indexing="ij",
    )
    inside = np.zeros(x.shape, bool)
    inside[1:-1, 1:-1] = True
    return x - AT[0], y - AT[1], inside


def membrane(spacing, shape, force):
    x, y, inside = grid(spacing)
    return solve_contact(
        shape(x, y), inside, spacing, pressure=PRESSURE, tension=TENSION, force=force
    )


def ball(radius):
    return lambda x, y: np.where(
        np.hypot(x, y) < radius, radius - np.sqrt(np.maximum(radius**2 - x**2 - y**2, 0)), np.inf
    )


@pytest.mark.parametrize(
    ("radius", "force"), [(3e-3, 0.03), (8e-3, 0.03), (8e-3, 0.4), (16e-3, 0.3)]
)
def test_contact_area_of_a_ball_follows_from_force_pressure_and_tension(radius, force):
    found = membrane(4e-4, ball(radius), force)
    # the membrane leaves without a kink: the contact on the ball carries p + 2 T/R everywhere
    visible_from_below = found.fraction.sum() * found.spacing**2
    # of a contact 1.1 mm wide, in cells of 0.4 mm; it falls with the cells' square
    assert visible_from_below == pytest.approx(force / (PRESSURE + 2 * TENSION / radius), rel=0.02)
    assert found.force.sum() == pytest.approx(force, rel=1e-6)  # the linear solver's
    assert found.settled


def test_contact_area_of_a_face_ends_at_its_edges():
    found = membrane(3e-4, lambda x, y: np.where(np.hypot(x, y) < 5e-3, 0.0, np.inf), 0.8)
    # cells on a circle; and they lie flat but for the rim
    assert found.area == pytest.approx(np.pi * 5e-3**2, rel=0.02)


def test_contact_area_of_a_ridge_is_nearly_zero():
    areas = [
        membrane(spacing, lambda x, y: np.where(abs(y) < 5e-3, abs(x), np.inf), 0.2).area
        for spacing in (6e-4, 3e-4)
    ]
    # less than the row of cells it crosses, and with their width
    assert areas[1] < 0.6 * areas[0] < 0.6 * 10e-3 * 6e-4


def pressed(indenter, mesh, depth, **placing):
    world = PressWorld("dense", Indenter.parse(indenter), mesh=mesh, **placing)
    world.inflate(world.design.chamber.supply_gauge, seal=True)
    world.press(depth)
    return world


def test_contact_area_is_independent_of_the_mesh():
    coarse, fine = (pressed("sphere:8", mesh, 3e-3) for mesh in ((13, 11), (21, 16)))
    areas = [1e6 * ground_truth.contact_area(world, 0) for world in (coarse, fine)]
    # 53.3, 52.0, 51.1 mm^2 on 13 x 11, 25 x 21 and 41 x 31 vertices, where touching vertices stand
    # for 87, 50, 53
    assert areas == pytest.approx([51.1, 51.1], rel=0.06)


def test_contact_area_of_a_face_and_without_contact():
    world = pressed("cylinder:5", (13, 11), 3e-3, at=(1e-3, 2e-3))
    assert ground_truth.contact_area(world, 0) == pytest.approx(np.pi * 5e-3**2, rel=0.02)
    world.lift_off()
    world.step(5)
    assert ground_truth.contact_area(world, 0) == 0.0


@pytest.mark.parametrize("depth", [8e-3, 13e-3])
def test_the_contact_area_is_at_most_that_of_the_lower_half_of_the_ball(depth):
    # the membrane next to a deep ball is steeper than the ball
    world = PressWorld("dense", Indenter("sphere", 5e-3))
    world.inflate(world.design.chamber.supply_gauge, seal=True)
    world.press(depth)
    assert 0 < ground_truth.contact_area(world, 0) <= 2 * np.pi * 5e-3**2


def test_the_contact_area_of_a_box_is_its_face():
    x, y, inside = grid(2e-4)
    height = np.where(np.maximum(np.abs(x), np.abs(y)) < 5e-3, 0.0, np.inf)
    contact = solve_contact(height, inside, 2e-4, pressure=4e3, tension=60.0, force=3.0)
    assert contact.area == pytest.approx((height == 0).sum() * 2e-4**2)
