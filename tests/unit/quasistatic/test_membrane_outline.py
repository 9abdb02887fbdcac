"""Tests of the quasi-static membrane in frames other than rectangles: against closed forms, Ritz's
method, and rectangles rotated on the grid."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from mjtactile import InputError, QuasistaticMembrane, load_sensor
from mjtactile.core.neo_hookean import Law
from mjtactile.core.ritz_bulge import inflated_height
from mjtactile.quasistatic.interpolation import interpolation_matrix

PRESSURE = 1000.0
HALF = 15e-3
ROUND = load_sensor("round30")
HEXAGON = tuple((HALF * np.cos(a), HALF * np.sin(a)) for a in np.arange(6) * np.pi / 3)
OUTLINES = {
    "circle": ROUND,
    "ellipse": load_sensor("ellipse"),
    "rounded": replace(
        ROUND, frame=replace(ROUND.frame, shape="rounded", width=20e-3, corner_radius=4e-3)
    ),
    "hexagon": replace(
        ROUND, frame=replace(ROUND.frame, shape="polygon", corners=HEXAGON, corner_radius=2e-3)
    ),
}
SHAPES = pytest.mark.parametrize("design", OUTLINES.values(), ids=OUTLINES)


@SHAPES
def test_the_membrane_rests_where_ritz_s_does(design):
    rest = QuasistaticMembrane(design, (41, 31), PRESSURE).rest
    # 0.05 % of the rectangle at this spacing; a staircase of held nodes moves the rim by half a spacing of 30
    height = inflated_height(design, PRESSURE)
    assert rest.heights[20, 15] == pytest.approx(height, rel=5e-4)


def test_a_taut_circle_is_a_paraboloid():
    membrane = replace(ROUND.membrane, law=Law.STVK)
    pressure = 20.0
    rest = QuasistaticMembrane(replace(ROUND, membrane=membrane), (41, 41), pressure).rest
    height = pressure * HALF**2 / (4 * membrane.pretension)  # 39 um: stretched by 1e-5 more
    # the chords that stand for the circle are 0.1 % of its radius inside, of a cell that varies
    assert rest.heights[20, 20] == pytest.approx(height, rel=1e-3)
    assert rest.volume == pytest.approx(height * np.pi * HALF**2 / 2, rel=3e-3)


@SHAPES
def test_the_error_of_the_outline_falls_with_the_square_of_the_spacing(design):
    volumes = [QuasistaticMembrane(design, (n, n), PRESSURE).rest.volume for n in (16, 31, 61)]
    # 4 in theory; nodes lie at any distance from an outline, which scatters it
    assert 2.6 < (volumes[1] - volumes[0]) / (volumes[2] - volumes[1]) < 6


def turned_square(angle):
    """Return a square frame with minimum corner radius, rotated on the grid, and its rotation."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    corners = HALF * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ R[:2, :2].T
    side = 2 * np.abs(corners).max()
    frame = replace(
        ROUND.frame, shape="polygon", corners=tuple(map(tuple, corners)), corner_radius=0.5e-3,
        length=side, width=side,
    )  # fmt: skip
    return replace(ROUND, frame=frame), R


def square_membrane():
    frame = replace(load_sensor("dense").frame, length=2 * HALF, width=2 * HALF)
    return QuasistaticMembrane(replace(ROUND, frame=frame), (31, 31), PRESSURE)


def bodies(solver, R):
    top = float(solver.rest.heights.max())
    place = (R @ [4e-3, 2e-3, top - 1.5e-3]) + [0, 0, 6e-3]
    yield solver.obstacle("sphere", (6e-3,), p_SO=place)
    yield solver.obstacle("cylinder", (4e-3, 6e-3), p_SO=place)
    yield solver.obstacle("sphere", (4e-3,), p_SO=(R @ [9e-3, 0, top - 2e-3]) + [0, 0, 4e-3])


@pytest.mark.parametrize("degrees", [20, 45])
def test_a_rotated_square_is_a_square(degrees):
    """At 45 degrees it is symmetric as the film's matrices are, at 20 it is not."""
    design, R = turned_square(np.radians(degrees))
    count = 2 * round(design.frame.length / 2e-3) + 1
    solver = QuasistaticMembrane(design, (count, count), PRESSURE)
    plain = square_membrane()
    assert solver.rest.volume == pytest.approx(plain.rest.volume, rel=4e-3)  # spacings' squares
    for turned, straight in zip(bodies(solver, R), bodies(plain, np.eye(3)), strict=True):
        state, other = solver.solve(turned), plain.solve(straight)
        assert state.converged
        # on nodes 1 mm apart balls and faces are within 2 % of the full membrane (bench
        # quasistatic)
        assert state.force_normal == pytest.approx(other.force_normal, rel=0.03)
        assert state.gauge_pressure == pytest.approx(other.gauge_pressure, rel=5e-3)
        np.testing.assert_allclose(R.T @ state.wrench[:3], other.wrench[:3], atol=6e-3)
        stuck, held = solver.patches(state)[0], plain.patches(other)[0]
        pulled = R[:2, :2].T @ stuck.stiffness[:2, :2] @ R[:2, :2]
        # on whole nodes of a contact three to five of them wide
        np.testing.assert_allclose(pulled, held.stiffness[:2, :2], atol=0.13 * pulled[0, 0])


@pytest.mark.parametrize("name", ["circle", "hexagon"])
def test_derivatives_are_differences(monkeypatch, name):
    monkeypatch.setattr(
        "mjtactile.quasistatic.membrane.TOLERANCE", 1e-10
    )  # tolerance in m; differences are 1e-6
    solver = QuasistaticMembrane(OUTLINES[name], (21, 17), PRESSURE)
    top = float(solver.rest.heights.max())

    def settled(at, state=solver.rest):
        for _ in range(3):  # a solution updates obstacles in three steps only
            state = solver.solve(solver.obstacle("sphere", (8e-3,), at), state)
        return state

    at = np.array([3.3e-3, -2.7e-3, top - 1e-3 + 8e-3])
    state = settled(at)
    by = solver.derivatives(state, lambda n: solver.obstacle("sphere", (8e-3,), n), at)
    for k, step in enumerate(1e-6 * np.eye(3)):
        low, high = settled(at - step, state), settled(at + step, state)
        displaced = (high.displacements - low.displacements) / 2e-6
        # error of the differences, as for rectangles
        np.testing.assert_allclose(by.displacements[k], displaced, atol=1e-3 * np.ptp(displaced))
        force = (high.force_normal - low.force_normal) / 2e-6
        # stiffness, N/m
        assert by.force_normal[k] == pytest.approx(force, rel=1e-3, abs=1e-3 * 150)


@SHAPES
def test_between_nodes_a_membrane_is_as_smooth_as_its_outline(design):
    """Between its nodes a coarse membrane agrees with a finer one, at random positions up to the
    rim."""
    outline = design.frame.outline
    rng = np.random.default_rng(0)
    places = outline.plane(rng.uniform(-0.95, 0.95, (60, 2)))
    coarse, fine = (
        interpolation_matrix(solver, places) @ solver.rest.heights.ravel()
        for solver in (
            QuasistaticMembrane(design, (21, 21), PRESSURE),
            QuasistaticMembrane(design, (41, 41), PRESSURE),
        )
    )
    # nodes are 1.5 mm apart. The error is 20 um within half a millimeter of corners with about that
    # radius. Without the continuation beyond the rim it is 200 everywhere
    np.testing.assert_allclose(coarse, fine, atol=25e-6)
    assert np.median(np.abs(coarse - fine)) < 1e-6


def test_contact_with_the_round_rim_is_reported():
    solver = QuasistaticMembrane(ROUND, (21, 21), PRESSURE)
    aside = HALF / np.sqrt(2)  # within the square about it, and over the rim
    ball = solver.obstacle("sphere", (5e-3,), p_SO=(aside, aside, 4e-3))
    with pytest.raises(InputError, match="rim"):
        solver.solve(ball)


def test_a_pickled_membrane_keeps_its_outline():
    solver = QuasistaticMembrane(ROUND, (21, 21), PRESSURE)
    again = pickle.loads(pickle.dumps(solver))
    ball = solver.obstacle("sphere", (5e-3,), p_SO=(0, 0, 6e-3))
    assert np.array_equal(again.solve(ball).heights, solver.solve(ball).heights)


@pytest.mark.parametrize("name", ["circle", "hexagon"])
def test_derivatives_are_independent_of_old_memory_content(name):
    solver = QuasistaticMembrane(OUTLINES[name], (21, 17), PRESSURE)
    top = float(solver.rest.heights.max())
    state = solver.solve(solver.obstacle("sphere", (8e-3,), (3.3e-3, -2.7e-3, top + 7e-3)))
    before = solver.derivatives_by_pose(state).displacements
    solver._derive_room[:] = np.nan
    np.testing.assert_array_equal(solver.derivatives_by_pose(state).displacements, before)
