"""Tests of the linear update of a fit against membrane solutions on the true shapes."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile import load_sensor
from mjtactile.sensing.contact_shape.fit_state import Data, Prior, Problem
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.jacobian import exact_jacobian
from mjtactile.sensing.contact_shape.linear_update import Linearization
from mjtactile.sensing.contact_shape.primitives import ROUNDING, InitialGuess
from mjtactile.sensing.contact_shape.shape_models import FAMILIES

SD = 19e-6  # of a marker height, m
NOISE = 2.0
BALL = np.array([0.0, 0.0, -1.2, 100.0])
DISC = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 5.0])


@pytest.fixture(scope="module")
def forward():
    return ForwardModel(load_sensor("dense"), None, 1.3e-3)


def guess(forward):
    height = float(forward.membrane.rest.heights.max())
    rounding = ROUNDING * forward.spacing
    frame = np.array([0.01, 0.01])
    return InitialGuess(np.zeros(2), height, 3e-5, 0.0, frame, forward.nodes, rounding, 0.3)


def image_of(forward, name, theta):
    """Return the solution on a shape, and the image of its markers."""
    rows = FAMILIES[name].rows(theta[None], guess(forward))
    solution = forward.solve(rows)
    heights = forward.heights(solution.x[None])[0]
    ids = np.arange(len(heights))
    return solution, Data(ids, heights, np.eye(len(ids)) / SD, solution.force_normal, None)


def linearized(forward, name, theta, noise=0.0):
    """Return the linear model at the true shape, with a weak prior."""
    solution, data = image_of(forward, name, theta)
    rough = np.random.default_rng(1).normal(0, 1, len(data.heights))
    rough *= noise / np.sqrt(np.mean(rough**2))
    data = replace(data, heights=data.heights + rough)
    family = FAMILIES[name]
    prior = Prior(theta / family.sd, np.eye(len(theta)) * 1e-3)
    problem = Problem(forward, family, guess(forward), data, prior)
    at = problem.state(theta, solution)
    return Linearization(Fit.of(problem, at, exact_jacobian(problem, at)), prior)


@pytest.mark.parametrize(
    ("name", "start", "change"),
    [
        ("ball", BALL, [0.1, -0.06, -0.04, 4.0]),
        ("disc", DISC, [0.05, 0.05, -0.04, 0.01, -0.01, 0.1]),
    ],
)
def test_a_small_change_is_found_without_a_solution(forward, monkeypatch, name, start, change):
    """The second order of such a change is a tenth of it: heights bend by 2 um of 40."""
    linear = linearized(forward, name, start, SD)
    true, data = image_of(forward, name, start + change)
    monkeypatch.setattr(ForwardModel, "solve", None)
    found = linear.update(data, NOISE)
    assert found is not None
    sd = np.sqrt(np.diag(found.cov_with(NOISE)))
    # a third of a standard deviation of one image: invisible next to its noise
    assert (np.abs(found.theta - start - change) < 0.34 * sd).all()
    rise = true.force_normal - linear.fit.state.force_normal
    assert found.state.force_normal == pytest.approx(true.force_normal, abs=0.15 * abs(rise))
    assert abs(rise) > 0.004
    assert found.force == data.force and found.misfit < 0.02
    np.testing.assert_allclose(found.at.residual, data.residual(found.at.heights), atol=1e-9)


def test_noise_moves_the_linear_fit_by_its_covariance(forward):
    """Over many noises the squared deviations average to the number of parameters; 200 images leave
    a twentieth (three sd: 0.15). A step beyond the limits, three sd, is refused: one in a hundred."""
    linear = linearized(forward, "ball", BALL, SD)
    _, data = image_of(forward, "ball", BALL)
    squares = []
    for seed in range(200):
        noise = np.random.default_rng(seed).normal(0, SD, len(data.heights))
        found = linear.update(replace(data, heights=data.heights + noise), 9.0)
        if found is not None:
            off = found.theta - BALL
            squares.append(off @ np.linalg.solve(found.cov_with(1.0), off) / len(off))
    assert len(squares) > 190
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("name", "theta"),
    [
        ("ball", BALL + [0, 0, -0.3, 0]),  # deeper by 0.3 mm
        ("ball", BALL + [1.0, 0, 0, 0]),
        ("disc", DISC),  # another shape at the same position
    ],
)
def test_another_contact_is_refused(forward, name, theta):
    linear = linearized(forward, "ball", BALL, SD)
    _, data = image_of(forward, name, theta)
    assert linear.update(data, NOISE) is None


def test_markers_that_contradict_the_shape_are_refused(forward):
    """One of 81 markers is ten standard deviations off: the misfit rises by 1.2, noise by 0.5."""
    linear = linearized(forward, "ball", BALL, SD)
    data = image_of(forward, "ball", BALL)[1]
    noise = np.random.default_rng(3).normal(0, SD, len(data.heights))
    data = replace(data, heights=data.heights + noise)
    assert linear.update(data, 9.0) is not None
    noise[0] += 10 * SD
    assert linear.update(replace(data, heights=data.heights + noise), 9.0) is None
