"""How far a force may be off where a body is narrow for the grid."""

import numpy as np
import pytest

from mjtactile import Film


@pytest.fixture(scope="module")
def film():
    return Film("dense", grid=(21, 16), pressure_gauge=1000.0)


LYING = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def rod(x):
    return Film.obstacle("capsule", (2e-3, 4e-3), (x, 0, 3.2e-3), LYING)


def test_a_rod_is_held_with_the_fine_film_s_force_within_what_is_said(film):
    places = np.linspace(-1e-3, 1e-3, 8)
    fine = film.fine_enough(rod(0.0))
    # against 81 x 61 nodes: 0.277, 0.6 % off at any place
    forces = np.array([fine.solve(rod(x)).force_normal for x in places])
    assert np.ptp(forces) < 0.03 * forces.mean()  # as the film's page asks of rods
    states = [film.solve(rod(x)) for x in places]
    off = [abs(state.force_normal / forces.mean() - 1) for state in states]
    assert max(off) > 0.05  # else nothing is to be said of it
    assert np.sum(np.array(off) > states[0].doubt) <= 1  # "9 of 10"


def test_doubt_is_of_the_narrowest_and_falls_with_the_grid(film):
    ball, blade = film.obstacle("sphere", (8e-3,)), film.obstacle("box", (2e-4, 6e-3, 5e-3))
    assert film.doubt(ball) == pytest.approx(0.03 * film.spacing / 2e-3)
    assert film.doubt([ball, blade]) == film.doubt(blade) > 0.2
    assert film.doubt(()) == 0.0
    bowl = film.obstacle("quadric", (500.0, 100.0, 5e-3))  # as narrow as a ball of 2 mm
    assert film.doubt(bowl) == film.doubt(film.obstacle("sphere", (2e-3,)))
    assert film.doubt(film.obstacle("cone", (6e-3, 6e-3))) > film.doubt(blade)
    assert film.solve(()).doubt == 0.0


def test_a_film_is_as_fine_as_what_presses_it_wants(film):
    assert film.fine_enough(film.obstacle("sphere", (8e-3,)), within=0.03) is film
    finer = film.fine_enough(rod(0.0))
    assert finer.grid == (41, 31)
    assert finer is film.fine_enough(rod(0.0))
    assert finer.pressure_gauge == film.pressure_gauge
    wire = film.obstacle("capsule", (3e-4, 8e-3), (0, 0, 0), LYING)
    assert film.fine_enough(wire).grid == (81, 61)
    assert film.fine_enough(wire).doubt(wire) > 0.03
