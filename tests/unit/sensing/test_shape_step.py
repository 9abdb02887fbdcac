"""Tests of the steps of a fit against bounded least squares."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.fit_state import FitState, Prior
from mjtactile.sensing.contact_shape.gauss_newton import damped_step
from mjtactile.sensing.contact_shape.shape_models import FAMILIES

BALL = FAMILIES["ball"]
THETA = np.array([0.3, -0.2, 0.1, 100.0])


def standing(residual):
    zeros = np.zeros(0)
    return FitState(
        THETA, MembraneSolution(zeros, zeros, zeros), zeros, residual, float(residual @ residual)
    )


def step_problem(scale, seed):
    """Return a step on an image of 20 markers, and its least-squares problem: (rows, right
    sides)."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(20, 4)) * 30
    at = standing(scale * (J @ [0.3, -0.1, 0.1, 0.1] + rng.normal(size=20)))
    prior = Prior.of(BALL, THETA)
    step = damped_step(J, at, BALL, prior, 0.0)
    rows = np.vstack([J, np.eye(4)])
    sides = -np.concatenate([at.residual, THETA / BALL.sd - prior.mean])
    return step, rows, sides


@pytest.mark.parametrize("seed", range(3))
def test_a_short_step_equals_gauss_newton_and_predicts_its_gain(seed):
    step, rows, sides = step_problem(0.1, seed)
    best = np.linalg.lstsq(rows, sides, rcond=None)[0]
    np.testing.assert_allclose(step.by, best, rtol=1e-9)
    gained = sides @ sides - np.square(rows @ step.by - sides).sum()
    assert not step.cut and step.promised == pytest.approx(gained, rel=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_a_long_step_stays_where_membranes_are_straight(seed):
    """Bounds as written in stepping.py; nearly as good as the best step within them."""
    step, rows, sides = step_problem(30.0, seed)
    maximum = np.array([1.5, 1.5, 0.5, 0.6 * 100.0]) / BALL.sd
    assert (np.abs(step.by) <= maximum * (1 + 1e-12)).all()
    gained = sides @ sides - np.square(rows @ step.by - sides).sum()
    assert step.cut and step.promised == pytest.approx(gained, rel=1e-9)
    best = lsq_linear(rows, sides, (-maximum, maximum)).x
    could = sides @ sides - np.square(rows @ best - sides).sum()
    assert (
        step.promised > 0.3 * could
    )  # parameters are fixed successively, or all steps are shortened
