"""Tests of the common information of the images of a contact episode, against explicit normal
distributions."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile.sensing.contact_shape.gauss_newton import Prior
from mjtactile.sensing.contact_shape.hypotheses import (
    Candidate,
    Evaluation,
    PressHistory,
    ReportedKind,
)
from mjtactile.sensing.contact_shape.shape_filter import ShapeFilter
from mjtactile.sensing.contact_shape.shape_models import FAMILIES

BALL = FAMILIES["ball"]
TOUCHING = 40  # nodes
WRONG = np.hypot(0.03, 1.5 / TOUCHING)  # of a curvature in one evaluation (equations F19)


def estimate_of(k, J, place_precision=4.0, ended_early=0.0):
    """Create a fit with marker slopes J (n, 4) by x, y, z and curvature over their sd, exactly at
    curvature k 1/m.

    The prior of the position does not pull, that of the curvature does: to `ended_early` further
    below than where it balances the image.
    """
    theta = np.array([0.1, -0.2, 0.3, k])
    t = theta / BALL.sd
    precision = np.diag([place_precision] * 3 + [0.7])
    # the fit ends where the image's pull and the prior's are equal: the image alone has it at `own`
    mean = t.copy()
    mean[3] -= 0.2
    gradient = -precision @ (t - mean)
    own = t - np.linalg.solve(J.T @ J, gradient)
    mean[3] -= ended_early
    forces = np.zeros((10, 10))
    forces.flat[:TOUCHING] = 1e-3
    fit = SimpleNamespace(
        family=BALL,
        theta=theta,
        prior=Prior(mean, precision),
        curvature=J.T @ J,
        gradient=gradient,
        misfit=0.8,
        state=SimpleNamespace(contact_forces=forces),
    )
    return fit, own


def marginal(J, own, place):
    """Return mean and variance of the curvature over its sd, from the covariance of all parameters.

    The image has slopes J and parameters `own`. The position has a prior at `place`, the curvature
    none.
    """
    prior = np.diag([4.0, 4.0, 4.0, 0.0])
    precision = J.T @ J + prior
    mean = np.linalg.solve(precision, J.T @ J @ own + prior @ np.array([*place, 0.0]))
    return mean[3], np.linalg.inv(precision)[3, 3]


@pytest.mark.parametrize("k2", [100.0, 180.0])
def test_estimates_are_combined_with_heavy_tails(k2):
    rng = np.random.default_rng(0)
    common = ShapeFilter.of(BALL)
    means, variances = [], []
    for k in (100.0, k2):
        J = rng.normal(size=(81, 4)) * [2.0, 2.0, 5.0, 1.0]
        fit, own = estimate_of(k, J)
        mean, variance = marginal(J, own, fit.theta[:3] / BALL.sd[:3])
        means.append(mean)
        variances.append(variance + (WRONG * k / BALL.sd[3]) ** 2)
        common = common.with_observation(fit)
    growth, variance = common.growth
    # directions without information get a millionth
    assert growth == pytest.approx(means[1] / means[0] - 1, abs=1e-6)
    own = variances[1] - (WRONG * k2 / BALL.sd[3]) ** 2  # of the image alone
    assert variance == pytest.approx((variances[0] + own) / means[0] ** 2, rel=1e-4)
    precision = sum(1 / v for v in variances)
    both = sum(m / v for m, v in zip(means, variances, strict=True)) / precision
    # exact except for the 1e-6 that stands for unobserved parameters
    assert common.precision[0, 0] == pytest.approx(precision, rel=1e-4)
    assert common.information[0] / common.precision[0, 0] == pytest.approx(both, rel=1e-4)
    off = (means[1] - means[0]) ** 2 / sum(variances)
    # large changes count less: a Student t distribution with 6 degrees of freedom
    assert common.drift == pytest.approx(7 * np.log1p(off / 6), rel=1e-4)
    assert common.freedom == 1
    assert common.variance_factor == pytest.approx(max(1.0, common.drift))


def test_an_image_without_information_on_the_curvature_is_no_change():
    """A fit that ended before its minimum has a residual pull of the prior. In an image without
    information, it was a curvature of billions."""
    rng = np.random.default_rng(3)
    slopes = rng.normal(size=(81, 4)) * [2.0, 2.0, 5.0, 1.0]
    first, _ = estimate_of(100.0, slopes)
    once = ShapeFilter.of(BALL).with_observation(first)
    early, _ = estimate_of(100.0, slopes, ended_early=3.0)
    same = ShapeFilter.of(BALL).with_observation(early)
    assert same.information == pytest.approx(once.information, rel=1e-12)
    blind = slopes * [1.0, 1.0, 1.0, 1e-6]
    second, _ = estimate_of(140.0, slopes)
    second.curvature = blind.T @ blind
    second.gradient = blind.T @ rng.normal(size=81)
    twice = once.with_observation(second)
    assert twice.drift < 0.01
    assert twice.information / twice.precision[0] == pytest.approx(
        once.information / once.precision[0], rel=1e-4
    )


@pytest.mark.parametrize(("name", "power"), [("ball", 2), ("disc", 1)])
def test_a_coarse_mesh_explains_larger_changes(name, power):
    """The sag between vertices grows with the square of their spacing, the position error of a rim
    with the spacing."""
    family = FAMILIES[name]
    count = len(family.names)
    theta = np.where(family.kept, 5.0, 0.0)
    forces = np.zeros((10, 10))
    forces.flat[:5] = 1e-3
    exact = SimpleNamespace(
        family=family,
        theta=theta,
        prior=Prior(theta / family.sd, np.eye(count)),
        curvature=1e9 * np.eye(count),
        gradient=np.zeros(count),
        misfit=1.0,
        state=SimpleNamespace(contact_forces=forces),
    )
    sd = [
        ShapeFilter.of(family, ratio).with_observation(exact).precision[0, 0] ** -0.5
        for ratio in (1.0, 4.0)
    ]
    own = float(family.share[family.kept][0]), 1.5 / 5
    expected = np.hypot(own[0], 4.0**power * own[1]) / np.hypot(*own)
    assert sd[1] / sd[0] == pytest.approx(expected, rel=1e-3)


def test_a_model_that_was_not_fitted_follows_the_best():
    """It explains an image as well as the best one, at most within the noise: 40 of 200."""
    best = SimpleNamespace(
        log_evidence_with=lambda noise: -30.0 / noise, log_lacking_with=lambda noise: 80.0 / noise
    )
    model = Candidate(BALL, best, -50.0, ShapeFilter.of(BALL), behind=5.0)
    after = model.without(Evaluation(best, 0.0, model.common, 0.25), 2.0)
    assert after.image_log == pytest.approx(-50.0 - 0.25 * 15.0)
    assert after.possible == pytest.approx(0.25 * 40.0) and after.behind == 5.0
    held = model.without(Evaluation(best, 0.0, model.common, 0.0), 2.0)
    assert held.log == model.log and held.possible == 0.0


def test_errors_of_the_model_repeat_at_the_same_force():
    press = PressHistory((), None, 2.0, 0.3, (0.1, 0.3), 0, 1, 1.0, 0.3)
    assert press.adds_evidence(0.4) and press.adds_evidence(0.08)
    assert not press.adds_evidence(0.32) and not press.adds_evidence(0.2)


def test_one_image_does_not_drift():
    fit, _ = estimate_of(100.0, np.random.default_rng(1).normal(size=(81, 4)))
    assert ShapeFilter.of(BALL).with_observation(fit).drift == 0.0


def test_the_kind_is_constant_in_a_hold():
    """Noise moves a force by some per cent and a position by 0.1 mm; a new load is more."""
    place = np.array([1e-3, 2e-3])
    chosen = ReportedKind("smooth", 0.3, place)
    assert chosen.holds(0.32, place + 1e-4)
    assert not chosen.holds(0.4, place) and not chosen.holds(0.2, place)
    assert not chosen.holds(0.3, place + 6e-4)
