"""Every kind of body against another that is the same, or against statics; and what cannot be."""

import numpy as np
import pytest

from mjtactile import Film, InputError

CORNERS = np.array(np.meshgrid(*[[-3e-3, 3e-3]] * 2, [-5e-3, 5e-3])).reshape(3, -1).T


@pytest.fixture(scope="module")
def film():
    return Film("dense", grid=(21, 16), pressure_gauge=1000.0)


def force(film, *bodies):
    state = film.solve(bodies)
    assert state.converged
    return state.force_normal


def box_of_triangles():
    """The lower face of the box that CORNERS span, as two triangles."""
    a, b, c, d = (corner for corner in CORNERS if corner[2] < 0)
    return np.array([[a, b, c], [b, d, c]])


def test_triangles_and_hull_are_the_box_that_they_bound(film):
    place = (0.4e-3, -0.3e-3, 7e-3)
    box = force(film, film.obstacle("box", (3e-3, 3e-3, 5e-3), place))
    mesh = force(film, film.obstacle("mesh", p_SO=place, data=CORNERS))
    skin = force(film, film.obstacle("triangles", p_SO=place, data=box_of_triangles()))
    assert mesh == pytest.approx(box, rel=1e-6)
    assert skin == pytest.approx(box, rel=1e-6)


def test_triangles_that_move_press_as_the_body_that_they_follow(film):
    """A soft body hands over its skin's corners anew each step, in S."""
    state = None
    for height in (7.2e-3, 7e-3, 6.9e-3):
        skin = box_of_triangles() + (0.4e-3, -0.3e-3, height)
        state = film.solve(film.obstacle("triangles", data=skin), state)
    assert state is not None and state.converged
    box = force(film, film.obstacle("box", (3e-3, 3e-3, 5e-3), (0.4e-3, -0.3e-3, 6.9e-3)))
    assert state.force_normal == pytest.approx(box, rel=1e-3)


def test_a_quadric_and_a_field_of_heights_are_the_ball_near_its_pole(film):
    ball = film.obstacle("sphere", (20e-3,), (1e-3, 0, 21.5e-3))
    pressed = force(film, ball)
    quadric = film.obstacle("quadric", (50.0, 50.0, 0.01), (1e-3, 0, 1.5e-3))
    # its height is less by r^4 / 8 R^3: 3 um at the contact's rim of 3.5 mm, of 1.2 mm
    assert force(film, quadric) == pytest.approx(pressed, rel=0.01)
    x, y = np.meshgrid(film.x, film.y, indexing="ij")
    inside = np.maximum(20e-3**2 - (x - 1e-3) ** 2 - y**2, 1e-4)
    field = 21.5e-3 - np.sqrt(inside)
    # bilinear between nodes, which move by 0.1 mm
    heights = film.obstacle("heights", data=field)
    assert force(film, heights) == pytest.approx(pressed, rel=0.02)


def test_a_disc_is_a_cylinder_whose_rim_is_rounded(film):
    disc, cylinder = (
        force(film, film.obstacle(kind, sizes, (0.3e-3, 0, 0.0117)))
        for kind, sizes in (("disc", (5e-3, 0.01, 1e-4)), ("cylinder", (5e-3, 0.01)))
    )
    assert disc == pytest.approx(cylinder, rel=0.03)  # its flat face ends 0.03 mm further in


def test_a_plane_carries_what_the_gas_pushes_where_it_lies_on(film):
    state = film.solve(film.obstacle("plane", p_SO=(0, 0, 2e-3)))
    assert state.converged
    # what touches is flat: all of the gas's pressure on it is the force, but for cells at its rim
    flat = state.contact_forces > 0.9 * state.contact_forces.max()
    cell = (film.x[1] - film.x[0]) * (film.y[1] - film.y[0])
    inner = state.contact_forces[flat].min() / cell
    assert inner == pytest.approx(state.pressure_gauge, rel=0.05)  # nodes have moved apart by 4 %
    assert state.force_normal == pytest.approx(state.area * state.pressure_gauge, rel=0.15)


def test_bodies_far_apart_press_as_each_alone_but_for_the_gas(film):
    left, right = (film.obstacle("sphere", (4e-3,), (x, 0, 6e-3)) for x in (-8e-3, 8e-3))
    both = film.solve([left, right])
    one = film.solve(left)
    # the gas, which both press, makes each harder to press in
    assert 2 * one.force_normal < both.force_normal < 2.3 * one.force_normal
    assert both.wrench[4] == pytest.approx(0, abs=1e-5)  # by symmetry, N m


def test_cones_and_wedges_press_the_deeper_the_harder(film):
    for kind, sizes in (("cone", (6e-3, 6e-3)), ("wedge", (5e-3, 3e-3, 5e-3))):
        forces = [force(film, film.obstacle(kind, sizes, (0, 0, z))) for z in (2e-3, 1.5e-3, 1e-3)]
        assert 0 < forces[0] < forces[1] < forces[2]


@pytest.mark.parametrize("tilt", [0.1, 0.3, 0.7])
def test_a_tilted_box_is_met_at_its_edge(film, tilt):
    """Its flank is steeper than the sheet can follow; its edge is where both end."""
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    mirrored = turn.T
    forces = [
        force(film, film.obstacle("box", (4e-3, 4e-3, 4e-3), (0, y, 6.2e-3), R))
        for y, R in ((0.5e-3, turn), (-0.5e-3, mirrored))
    ]
    assert forces[0] == pytest.approx(forces[1], rel=1e-3)


def test_nothing_that_cannot_be_is_taken(film):
    for data, says in (
        (np.full((21, 16), np.nan), "finite"),
        (np.zeros((4, 3)), "volume"),
        ([[0.0, 0.0]], "shape"),
    ):
        kind = "heights" if says == "finite" else "mesh"
        with pytest.raises(InputError, match=says):
            film.obstacle(kind, data=data)
    with pytest.raises(InputError, match="rim"):
        film.solve(film.obstacle("plane", p_SO=(0, 0, -1e-3)))
    with pytest.raises(InputError, match="nodes"):
        film.solve(film.obstacle("heights", data=np.zeros((5, 5))))
