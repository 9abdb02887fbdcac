"""Tests of the error model fitted to a pipeline: synthetic rows of known spread."""

import numpy as np
import pytest

from benchmarks.learning import fit_error_model


def test_an_outlier_grasp_does_not_dominate_the_error_model():
    """One finger with ten times the error does not determine the fitted standard deviation of all.

    Twenty fingers of sd 5 mN have 400 images each at 0.5 N. The logarithm of their factors has sd
    0.3; one finger has 50 mN. The mean square over all would give 12 mN. The model's sd is a
    lognormal's root mean square, 5 mN times exp(0.3^2), widened by the outlier's part of the
    spread.
    """
    rng = np.random.default_rng(1)
    images = 400
    factors = np.exp(0.3 * np.linspace(-1.6, 1.6, 20))
    factors[7] = 10.0
    error = 5e-3 * np.repeat(factors, images)[:, None] * rng.standard_normal((20 * images, 6))
    rows = {
        "wrench": np.tile([0.0, 0.0, -0.5, 0.0, 0.0, 0.0], (20 * images, 1)),
        "seed": np.repeat(np.arange(20), images),
        "finger": np.zeros(20 * images, int),
    }
    near = fit_error_model._shares(np.full(20 * images, 0.5))
    mean, sd, factor, spread = fit_error_model._by_grasps(error, near, rows)
    at = int(np.flatnonzero(fit_error_model.LOADS == 0.5)[0])
    assert 5e-3 < sd[at, 2] < 8.5e-3 < np.sqrt((error[:, 2] ** 2).mean())
    assert not mean[:, :2].any()
    assert spread[at] == pytest.approx(np.std(np.log(factors)), rel=0.1)
    assert np.corrcoef(factor, np.repeat(factors, images))[0, 1] > 0.99


def test_white_noise_lasting_errors_and_errors_of_a_grasp_are_distinguished():
    """The fit separates white noise, lasting errors and the gain error of a grasp.

    Sixty fingers have 300 images each with shears between 0.1 and 0.3 N. Their white noise is 2 mN
    and the error that lasts half a second 8 mN. The gains have sd 6 % about 4 %; the 4 % is not
    sampled. Bounds: the median of 60 has a standard error of 1/7 of an sd, and 15 of a finger's 300
    images count as one. The bounds are three of these errors.
    """
    rng = np.random.default_rng(3)
    fingers, images, period = 60, 300, 1 / 30
    kept = np.exp(-period / 0.5)
    parts = []
    for _ in range(fingers):
        error = np.zeros((images, 6))
        state = rng.standard_normal(6)
        for row in error:
            state = kept * state + np.sqrt(1 - kept**2) * rng.standard_normal(6)
            row[:] = 8e-3 * state + 2e-3 * rng.standard_normal(6)
        true = np.zeros((images, 6))
        true[:, 1] = rng.uniform(0.1, 0.3)
        true[:, 2] = -0.5
        error[:, 1] += (0.04 + 0.06 * rng.standard_normal()) * true[:, 1]
        parts.append((true, error))
    true, error = (np.concatenate(item) for item in zip(*parts, strict=True))
    count = len(true)
    rows = {
        "status": np.full(count, "ok"),
        "wrench": true,
        "estimated": true + error,
        "cov": np.tile(1e-4 * np.eye(6), (count, 1, 1)),
        "touching": np.ones(count, bool),
        "seed": np.repeat(np.arange(fingers), images),
        "finger": np.zeros(count, int),
        "time": np.tile(period * np.arange(images), fingers),
    }
    for name in ("area", "depth"):
        rows |= {name: np.full(count, 1e-3), f"estimated_{name}": np.full(count, 1e-3)}
    rows |= {"centroid": np.zeros((count, 2)), "estimated_centroid": np.zeros((count, 2))}
    found = fit_error_model.fit(rows)
    at = int(np.flatnonzero(fit_error_model.LOADS == 0.5)[0])
    # the lasting error changes by 8 mN * sqrt(1 - kept^2) = 2.8 mN per image, a fifth of it in this
    # measure
    assert found.fresh[at, 2] == pytest.approx(2.2e-3, rel=0.2)
    assert found.sd[at, 2] == pytest.approx(8.2e-3, rel=0.1)
    assert found.shear_gain == pytest.approx(0.06, rel=0.4)
    assert found.slow_time == pytest.approx(0.5, rel=0.25)
    assert (found.outliers < 0.01).all()
    assert not found.gain[:2].any()
