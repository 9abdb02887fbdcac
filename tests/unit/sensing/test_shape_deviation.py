"""Deviation of a quadric from the fitted round shape, against closed forms and known quadrics."""

import numpy as np
import pytest

from mjtactile import load_sensor
from mjtactile.quasistatic.obstacles import unchecked_obstacles
from mjtactile.sensing.contact_shape.fit_state import Data, Prior, Problem
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import exactly, refine
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.quadric_deviation import _quadric_row, deviation
from mjtactile.sensing.contact_shape.shape_models import FAMILIES

PLACE = np.array([1e-3, -0.5e-3])
HEIGHT_SD = 10e-6  # of a marker, m: little of the prior remains
DEPTH = 2.5e-3  # m


@pytest.fixture(scope="module")
def forward():
    return ForwardModel(load_sensor("dense"), None, 1.3e-3)


def lowest_point(forward):
    top = float(forward.membrane.rest.heights.max())
    return np.array([*PLACE, top - DEPTH])


def fit(forward, name, numbers):
    """Fit a model to the markers of a membrane on the quadric with `numbers`."""
    row = _quadric_row(lowest_point(forward), *numbers)
    solution = forward.solve((row[None, None], None))
    heights = forward.heights(solution.x[None])[0]
    count = len(heights)
    root = np.eye(count) / HEIGHT_SD
    data = Data(np.arange(count), heights, root, solution.force_normal, None)
    hint = InitialGuess(
        PLACE, lowest_point(forward)[2], 2e-5, 0.0, np.array([0.02, 0.02]), forward.nodes, 6e-4, 0.3
    )
    start = np.array([0, 0, 0, 90.0, 0, 90.0] if name == "smooth" else [0, 0, 0, 90.0])
    problem = Problem(forward, FAMILIES[name], hint, data, Prior.of(FAMILIES[name], start))
    fitted = refine(problem, problem.fit_state(start, None), rounds=40, noise=1.0)
    return exactly(forward, fitted, data, 1.0, times=3), data


def test_the_ellipsoid_is_the_quadric(forward):
    K, g, vertical = np.array([[100.0, 20.0], [20.0, 50.0]]), np.array([8.0, -5.0]), 70.0
    at = np.random.default_rng(0).uniform(-3e-3, 3e-3, (6, 2))
    slant = 1 - at @ g
    z = (slant - np.sqrt(slant**2 - vertical * np.einsum("ni,ij,nj->n", at, K, at))) / vertical
    outward = np.column_stack([at @ K + np.outer(z, g), at @ g + vertical * z - 1])
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    # the mid-surface lies half the thickness below the outer face
    half = forward.membrane.design.membrane.thickness / 2
    middle = np.column_stack([at, z]) + half * outward
    body = unchecked_obstacles(_quadric_row(np.zeros(3), 100, 20, 50, 8, -5, 70)[None], None)
    heights = forward.membrane.obstacle_heights(list(body), middle[:, :2])
    # the kernel follows the normal of the obstacle to second order: 0.5 % of half the thickness
    np.testing.assert_allclose(heights, middle[:, 2], atol=0.005 * half)


@pytest.mark.parametrize("name", ["ball", "smooth"])
def test_a_shape_of_the_model_has_no_deviation(forward, name):
    fitted, data = fit(forward, name, (90.0, 0.0, 90.0, 0.0, 0.0, 90.0))
    found = deviation(forward, fitted, data, 1.0)
    sd = np.sqrt(np.diag(found.cov))
    # the prior of the curvature moves the fit by less than a tenth of its standard deviation
    assert (np.abs(found.theta) < 0.1 * sd).all()
    assert np.abs(found.unequal).max() < 0.1 * max(found.unequal_sd, 1e-9)


def test_a_skew_quadric_is_placed_closer(forward):
    fitted, data = fit(forward, "smooth", (110.0, 10.0, 80.0, 20.0, -14.0, 60.0))
    found = deviation(forward, fitted, data, 1.0)
    before, after = fitted.theta[:2], fitted.theta[:2] + found.theta[:2]  # mm from the true place
    assert np.hypot(*before) > 0.15
    assert np.hypot(*after) < 0.5 * np.hypot(*before)
    assert (np.abs(after) < 2 * np.sqrt(np.diag(found.cov))[:2]).all()


def test_an_ellipsoid_fitted_as_a_ball_has_two_curvatures(forward):
    fitted, data = fit(forward, "ball", (110.0, 0.0, 75.0, 0.0, 0.0, 110.0))
    found = deviation(forward, fitted, data, 1.0)
    mean = fitted.theta[3] + found.theta[3]
    both = mean + np.array([1, -1]) * np.hypot(*found.unequal)
    assert found.unequal[0] == pytest.approx(17.5, rel=0.2)  # first order: half of 110 - 75
    assert both == pytest.approx([110.0, 75.0], rel=0.1)


def test_faces_and_lines_have_no_curvature(forward):
    fitted, data = fit(forward, "ball", (90.0, 0.0, 90.0, 0.0, 0.0, 90.0))
    object.__setattr__(fitted, "family", FAMILIES["disc"])
    assert deviation(forward, fitted, data, 1.0) is None
