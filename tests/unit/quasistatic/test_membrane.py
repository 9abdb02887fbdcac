"""The film against independent solutions of the full membrane, against statics, and against
itself."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import benchmarks.quasistatic
from mjtactile import InputError, QuasistaticMembrane
from mjtactile.quasistatic import MembraneStatus

# Reference of an independent membrane of 9-node elements on `dense` at 1 kPa, neo-Hookean,
# frictionless, sealed: radius mm, position mm, force N, gauge pressure Pa, height of the ball's
# center relative to the mid-surface mm.
PRESSES = [
    (4, (0, 0), 0.0810926, 1118.4, 5.8699),
    (8, (0, 0), 0.0974136, 1141.6, 9.8699),
    (8, (0, 0), 0.2540922, 1382.1, 8.8699),
    (16, (0, 0), 0.3451353, 1509.0, 16.8699),
    (30, (0, 0), 0.4965699, 1706.5, 30.8699),
    (16, (7, -4), 0.3174556, 1431.5, 16.524),
]
HALF_THICKNESS = 0.15e-3


@pytest.fixture(scope="module")
def fine():
    return QuasistaticMembrane("dense", grid=(41, 31), gauge_pressure=1000.0)


@pytest.fixture(scope="module")
def coarse():
    return QuasistaticMembrane("dense", grid=(21, 16), gauge_pressure=1000.0)


def ball(membrane, radius, at, height):
    """Create a ball with its center at `height` mm above S, relative to the membrane's
    mid-surface."""
    return membrane.obstacle(
        "sphere", (1e-3 * radius - HALF_THICKNESS,), p_SO=(*(1e-3 * np.array(at)), 1e-3 * height)
    )


def test_equilibrium_is_that_of_the_complete_membrane(fine):
    # of the independent solution: 2.8699 mm, 1.68755 mL at 1 kPa; this grid is 0.04 and 0.25 % off, and falls with its square
    assert fine.rest.heights.max() == pytest.approx(2.8699e-3, rel=2e-3)
    assert fine.rest.volume == pytest.approx(1.68755e-6, rel=4e-3)


@pytest.mark.parametrize("press", PRESSES)
def test_force_of_a_ball_is_that_of_the_complete_membrane(fine, press):
    radius, at, force, pressure, height = press
    state = fine.solve(ball(fine, radius, at, height))
    assert state.converged
    assert state.force_normal == pytest.approx(
        force, rel=0.03
    )  # the contact's nodes are 1 mm apart
    assert state.gauge_pressure == pytest.approx(pressure, rel=3e-3)


def other_designs():
    """Return one reference case of each other membrane and pressure of the independent solver."""
    path = Path(benchmarks.quasistatic.__file__).with_name("membrane_reference.json")
    cases = json.loads(path.read_text(encoding="utf-8"))["cases"]
    requested = {"kind": "ball", "size_mm": [16.0], "at_mm": [0.0, 0.0], "depth_mm": 2.0}
    usual = {"thickness_mm": 0.3, "pre_stretch": 1.05, "rest_Pa": 1000.0}
    found = [c for c in cases if requested.items() <= c.items() and not usual.items() <= c.items()]
    names = ["-".join(str(c[key]) for key in usual) for c in found]
    return [pytest.param(case, id=name) for case, name in zip(found, names, strict=True)]


@pytest.mark.parametrize("case", other_designs())
def test_other_membranes_and_pressures_agree_with_the_complete_membrane(case):
    membrane = benchmarks.quasistatic._membrane(case, (41, 31))
    state = membrane.solve(benchmarks.quasistatic._obstacle_of(membrane, case))
    # nodes are 1 mm apart, in the independent membrane 0.5 mm
    assert state.force_normal == pytest.approx(case["force_N"], rel=0.015)
    assert state.gauge_pressure == pytest.approx(case["pressure_Pa"], rel=3e-3)


def test_frame_and_body_carry_the_gas_load(fine):
    state = fine.solve(ball(fine, 8, (3, -2), 8.5))
    slope_free = fine.solve(ball(fine, 8, (3, -2), 8.5), state)
    assert slope_free.steps <= 3  # it is there already
    # a mirrored press is a mirrored state
    mirrored = fine.solve(ball(fine, 8, (-3, 2), 8.5))
    assert mirrored.force_normal == pytest.approx(state.force_normal, rel=1e-5)
    np.testing.assert_allclose(mirrored.heights[::-1, ::-1], state.heights, atol=2e-6)


def test_a_single_step_and_many_steps_have_the_same_force(coarse):
    state = coarse.rest
    for height in np.linspace(10.8, 5.0, 30):
        state = coarse.solve(ball(coarse, 8, (1, 0.5), height), state)
    jump = coarse.solve(ball(coarse, 8, (1, 0.5), 5.0))
    assert state.converged and jump.converged
    assert jump.force_normal == pytest.approx(state.force_normal, rel=2e-4)


def test_a_membrane_extrapolates_the_motion_of_its_obstacle(coarse):
    """With extrapolation, an obstacle at constant speed needs half the steps; a reversal has the
    same solution."""
    steps = {True: 0, False: 0}
    for kept in steps:
        state = coarse.rest
        for height in (*np.arange(9.0, 8.4, -0.05), 8.55, 8.65):
            body = ball(coarse, 8, (2, 1), height)
            state = coarse.solve(body, state if kept else replace(state, trend=None))
            afresh = coarse.solve(body)
            # force error for a tolerance of 0.5 um
            assert state.force_normal == pytest.approx(afresh.force_normal, rel=2e-3)
            steps[kept] += state.steps
    assert steps[True] < 0.75 * steps[False]


@pytest.mark.parametrize(
    ("kind", "sizes", "p_SO", "message"),
    [
        ("sphere", (0.008,), (0.016, 0, 0.004), "rim"),
        ("sphere", (0.008,), (0, 0, -0.0125), "glass"),
        ("capsule", (0.001, 0.02), (0, 0, 0.013), "between"),  # a pin, between nodes
        ("sphere", (0.004,), (0, 0, -0.008), "inside out"),
        ("sphere", (0.008,), (0, 0, np.nan), "finite"),
        ("sphere", (-0.008,), (0, 0, 0.01), "positive"),
        ("ball", (0.008,), (0, 0, 0.01), "unknown"),
    ],
)
def test_impossible_values_are_refused_in_one_line(coarse, kind, sizes, p_SO, message):
    with pytest.raises(InputError, match=message) as caught:
        coarse.solve(coarse.obstacle(kind, sizes, p_SO=p_SO))
    assert "\n" not in str(caught.value)


def test_a_node_pulled_to_the_glass_exceeds_the_rubber_law(coarse):
    heights = np.full(coarse.grid, np.inf)
    heights[10, 8] = -0.018
    with pytest.raises(InputError, match="material model"):
        coarse.solve(coarse.obstacle("heights", data=heights))


def test_a_solution_that_does_not_converge_is_nan(coarse):
    """A solution that does not converge gives NaN, and a batch reports the status of each obstacle.

    One case is a ball pressed to its equator next to the rim.
    """
    deep = coarse.obstacle("sphere", (0.004,), p_SO=(0.012, 0.007, -0.004))
    rim = coarse.obstacle("sphere", (0.008,), p_SO=(0.016, 0, 0.004))
    fine = coarse.obstacle("sphere", (0.008,), p_SO=(0, 0, 0.009))
    batch = coarse.solve_batch([[deep], [rim], [fine]])
    assert batch.converged.tolist() == [False, False, True]
    assert np.isnan(batch.force_normal[:2]).all() and batch.force_normal[2] > 0
    lost = batch[0]
    assert lost.status in (MembraneStatus.NOT_CONVERGED, MembraneStatus.INVERTED)
    assert batch[1].status is MembraneStatus.RIM_CONTACT
    numbers = (lost.gauge_pressure, lost.area, lost.volume, *lost.wrench)
    assert np.isnan(numbers).all() and np.isnan(lost.heights).all()
    again = coarse.solve_batch([[fine]] * 3, batch)  # from rest, without contact
    assert again.converged.all()


def test_a_batch_equals_single_membranes_for_any_thread_count(coarse):
    obstacles = [[ball(coarse, 8, (k, -k), 9.5)] for k in range(5)]
    one, three = (coarse.solve_batch(obstacles, threads=threads) for threads in (1, 3))
    assert one.converged.all()
    np.testing.assert_array_equal(one.x, three.x)
    np.testing.assert_array_equal(one.found, three.found)
    alone = coarse.solve(obstacles[3][0])
    np.testing.assert_array_equal(one[3].x, alone.x)
    on = [coarse.solve_batch(obstacles, one, threads=threads) for threads in (2, 5)]
    np.testing.assert_array_equal(on[0].force, on[1].force)
    np.testing.assert_array_equal(on[0].trend, on[1].trend)
    again = coarse.solve_batch(obstacles, one, into=three)  # in memory of another, and in its own
    assert again is three
    np.testing.assert_array_equal(again.x, on[0].x)
    np.testing.assert_array_equal(coarse.solve_batch(obstacles, one, into=one).trend, on[0].trend)
    with pytest.raises(InputError, match="into"):
        coarse.solve_batch(obstacles[:3], into=one)


def test_a_pickled_membrane_is_the_same(coarse):
    membrane = pickle.loads(pickle.dumps(coarse))
    body = ball(coarse, 8, (1, 2), 9.5)
    np.testing.assert_array_equal(membrane.solve(body).x, coarse.solve(body).x)


@pytest.mark.parametrize(
    ("half", "depth", "force"), [(3e-3, 1e-3, 0.183), (6e-3, 1.5e-3, 0.595)], ids=["6 mm", "12 mm"]
)
def test_a_face_has_its_force_wherever_its_edges_fall(coarse, half, depth, force):
    """A flat face has the force of the independent membrane at any position of its edges on the
    grid.

    The independent grid makes faces too small; its force is extrapolated to zero spacing.
    """
    forces = []
    areas = []
    for at in [(0, 0), (0.5e-3, 0.3e-3), (1e-3, -0.7e-3), (1.3e-3, 0.2e-3)]:
        center = 2.8699e-3 - depth + HALF_THICKNESS + 0.01
        state = coarse.solve(coarse.obstacle("box", (half, half, 0.01), p_SO=(*at, center)))
        forces.append(state.force_normal)
        areas.append(state.area)
    np.testing.assert_allclose(forces, force, rtol=0.05)  # on nodes 2 mm apart
    np.testing.assert_allclose(areas, 4 * half**2, rtol=0.02)


@pytest.mark.parametrize("turn", [0.0, 17.0])
def test_a_blade_is_not_lost_between_nodes(coarse, turn):
    """Wherever it is, between nodes or on them, and with its ends between them too."""
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    R_SO = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    blade = coarse.obstacle("box", (2e-4, 6e-3, 0.01), R_SO=R_SO)
    forces = [
        coarse.solve(blade.at((x, y, 0.0102))).force_normal
        for x, y in [(0, 0.3e-3), (0.5e-3, 0), (1e-3, 0.8e-3), (0.7e-3, -0.4e-3), (-0.2e-3, 0.1e-3)]
    ]
    # ends of an aligned blade cross edges; a rotated blade crosses lines of nodes 2 mm apart
    assert np.ptp(forces) < (0.1 if turn else 0.03) * np.mean(forces)


def test_a_rotated_blade_touches_every_line_that_it_crosses(fine):
    """A rotated blade touches every grid line that it crosses.

    It crosses the last line half a spacing from its end, 0.3 spacings from a node.
    """
    angle = 0.3
    c, s = np.cos(angle), np.sin(angle)
    at = (9.683e-04, -2.605e-04)
    blade = fine.obstacle(
        "box", (2e-4, 6e-3, 0.01), (*at, 0.0102), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    )
    state = fine.solve(blade)
    touched = (state.contact_forces > 0).any(axis=0)
    crossed = np.abs(fine.y - at[1]) < 6e-3 * c - 0.2e-3  # nodes have moved by less
    assert touched[crossed].all()


def test_symmetric_bodies_are_the_same_in_any_turn(coarse):
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    straight = coarse.solve(coarse.obstacle("box", (4e-3, 2e-3, 0.01), p_SO=(0, 0, 0.0118)))
    turned = coarse.solve(coarse.obstacle("box", (2e-3, 4e-3, 0.01), (0, 0, 0.0118), quarter))
    assert turned.force_normal == pytest.approx(straight.force_normal, rel=1e-4)


def test_capsule_ellipsoid_and_hull_agree_with_similar_shapes(coarse):
    sphere = coarse.solve(coarse.obstacle("sphere", (8e-3,), p_SO=(1e-3, 0, 9e-3))).force_normal
    same = [("capsule", (8e-3, 1e-9)), ("ellipsoid", (8e-3, 8e-3, 8e-3))]
    for kind, sizes in same:
        state = coarse.solve(coarse.obstacle(kind, sizes, p_SO=(1e-3, 0, 9e-3)))
        assert state.force_normal == pytest.approx(sphere, rel=2e-3)
    corners = np.array(np.meshgrid(*[[-3e-3, 3e-3]] * 2, [-5e-3, 5e-3])).reshape(3, -1).T
    hull = coarse.solve(coarse.obstacle("mesh", p_SO=(0, 0, 7e-3), data=corners))
    box = coarse.solve(coarse.obstacle("box", (3e-3, 3e-3, 5e-3), p_SO=(0, 0, 7e-3)))
    assert hull.force_normal == pytest.approx(box.force_normal, rel=1e-6)


@pytest.mark.parametrize("y", [0.0, 0.4e-3, 1e-3])
def test_a_ridge_between_nodes_is_met(coarse, fine, y):
    forces = [
        membrane.solve(
            membrane.obstacle("wedge", (5e-3, 3e-3, 5e-3), p_SO=(0, y, 1.5e-3))
        ).force_normal
        for membrane in (coarse, fine)
    ]
    # nodes are 2 mm apart: a row may be a millimeter from the edge, and the flanks make contact at
    # nodes
    assert forces[0] == pytest.approx(forces[1], rel=0.2)


def test_shear_moves_a_contact_as_far_as_an_independent_membrane(fine):
    """A sticking ball of 8 mm, 2 mm deep, moved by 0.3 mm in the independent solution. There the
    nodes in contact move rigidly; here shear is distributed like the normal force, so that their
    mean moves 8 % farther."""
    obstacles = [ball(fine, 8, (0, 0), 8.8699)]
    start = fine.solve(obstacles)
    sheared = fine.resume(obstacles[0].parameters[None], None, start, shear=np.array([0.1429, 0.0]))
    assert sheared.converged
    moved = (sheared.displacements - start.displacements)[:, sheared.contact_forces > 0]
    assert moved[0].mean() == pytest.approx(1.08 * 0.3e-3, rel=0.03)
    assert abs(moved[1].mean()) < 1e-8
    # the membrane ahead rises by as much as it falls behind, to first order
    rise = (sheared.heights - start.heights)[[8, 32], 15]
    assert rise[1] > 1e-4 and rise[0] == pytest.approx(-rise[1], rel=0.1)
