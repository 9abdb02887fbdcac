"""Tests of the indentation by a small contact beyond that on a mesh, against a lattice and closed
forms."""

import numpy as np
from scipy.sparse import diags, identity, kron
from scipy.sparse.linalg import spsolve

from mjtactile.sim.sensor import subgrid_indentation

DIRECTIONS = 4


def _lattice_depth(count: int) -> float:
    """Return the depth under a unit force at the center of a square lattice of `count` free points
    per side, tension 1, cell 1."""
    line = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(count, count))
    load = np.zeros(count * count)
    load[count * count // 2] = 1.0
    return float(
        spsolve((kron(line, identity(count)) + kron(identity(count), line)).tocsc(), load).max()
    )


def test_radius_of_a_mesh_vertex_is_that_of_a_lattice():
    """The equivalent radius of the mesh is that of a lattice.

    A disc of radius a under uniform pressure in a square of side L gives (1/2 pi)(ln(L/a) + c). The
    constant c is from the textbook's point load in a square, ln(L/r) + ln(0.5394), by the conformal
    radius 0.5394 L.
    """
    count = 101
    side = count + 1
    expected = np.log(0.5394 * side / subgrid_indentation.MESH_RADIUS) / (2 * np.pi)
    # the conformal radius has four digits, ends O(1/n^2)
    np.testing.assert_allclose(_lattice_depth(count), expected, rtol=2e-3)


def test_a_small_ball():
    """Under an even pressure F/(pi a^2) with a^2 = 2 F R/(2 pi T): ln(mesh/a) + 1/2."""
    # of a ball of 5 cells
    load = np.array([1e-3])
    curvature = np.full((1, DIRECTIONS), 2.0 / 5.0)
    depth, radius = subgrid_indentation.depth_beyond_mesh(
        load, np.zeros((1, DIRECTIONS)), curvature
    )
    a = np.sqrt(load * 5.0)  # load = F/(2 pi T): a sin(a/R) = load, small angles
    np.testing.assert_allclose(radius, a, rtol=1e-3)
    np.testing.assert_allclose(
        depth, load * (np.log(subgrid_indentation.MESH_RADIUS / a) + 0.5), rtol=1e-2
    )


def test_a_shallow_cone():
    """The contact ends at a sin(angle) = F/(2 pi T); inside, the membrane follows the cone:
    ln(mesh/a) + 1, up to the slope 0.05 squared."""
    load = np.array([0.001])
    depth, radius = subgrid_indentation.depth_beyond_mesh(
        load, np.full((1, DIRECTIONS), 0.05), np.zeros((1, DIRECTIONS))
    )
    np.testing.assert_allclose(radius, load * 20, rtol=2e-3)
    np.testing.assert_allclose(
        depth, load * (np.log(subgrid_indentation.MESH_RADIUS / radius) + 1), rtol=2e-3
    )


def test_a_steep_cone():
    """The membrane around a cone of 90 degrees, integrated: tension 1 + 2 (1/cos - 1) times sine
    times radius is the load. This gives its depth to a radius R; that of the mesh is load
    ln(R/mesh)."""
    load = 0.05
    far = 1e-4
    angle = np.geomspace(far, np.pi / 4, 20000)
    radius = load / ((1 + 2 * (1 / np.cos(angle) - 1)) * np.sin(angle))
    falls = -np.trapezoid(np.tan(angle), radius) + radius[-1]  # and the cone itself, inside
    depth, _ = subgrid_indentation.depth_beyond_mesh(
        np.array([load]), np.ones((1, DIRECTIONS)), np.zeros((1, DIRECTIONS))
    )
    # the trapezoids' error
    np.testing.assert_allclose(
        depth, falls - load * np.log(radius[0] / subgrid_indentation.MESH_RADIUS), rtol=1e-4
    )


def test_a_straight_edge_equals_a_row_of_vertices():
    """A line of equal forces deforms membrane and mesh equally, up to the 0.08 of ln(0.198/0.25) +
    1 - ln 2."""
    slope = np.array([[0.0, 0.7, 1.0, 0.7]])
    load = np.array([0.02])
    assert (
        abs(subgrid_indentation.depth_beyond_mesh(load, slope, np.zeros_like(slope))[0][0])
        < 0.15 * load[0]
    )


def test_two_vertices_on_a_tip_share_its_load():
    loads = np.array([0.1, 0.1])
    radii = np.array([0.2, 0.2])
    vertices = np.array([[0.0, 0.0], [1.0, 0.0]])
    at_one_place = subgrid_indentation.depth_of_neighbours(
        loads, radii, vertices, np.array([[0.5, 0.0], [0.5, 0.0]])
    )
    np.testing.assert_allclose(at_one_place, 0.1 * np.log(1 / (0.39 * 0.4)))
    np.testing.assert_array_equal(
        subgrid_indentation.depth_of_neighbours(loads, radii, vertices, vertices), 0.0
    )


def test_indenter_profiles_agree_with_quadrature():
    radii = (0.15, 0.373)
    for slope, curvature in ((0.7, 0.0), (0.0, 0.4), (0.3, 0.2)):
        rises = [np.array([slope * r + curvature * r**2 / 4]) for r in radii]
        np.testing.assert_allclose(
            np.ravel(subgrid_indentation.profile(*rises, radii)), [slope, curvature], atol=1e-12
        )
