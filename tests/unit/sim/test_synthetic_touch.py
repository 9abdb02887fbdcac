"""Tests that sampled touch has the errors of its model, and reports its level."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.runtime.controller import Controller
from mjtactile.runtime.grasp import run_grasp
from mjtactile.runtime.session import open_session
from mjtactile.sim.camera import SimCamera
from mjtactile.sim.effects.catalog import choose
from mjtactile.sim.sensing_error_model import load_errors, parse_error_model
from mjtactile.sim.synthetic_touch import SensingErrorSampler

DENSE = load_sensor("dense")
PERIOD = 1 / 30
SAMPLED = "-mesh,-pipeline"


def test_errors_have_the_mean_spread_and_memory_that_the_model_states():
    """Sampled errors have the mean, spread and time correlation of the model.

    The test has 20000 images at one load. Bounds are four standard errors, including the
    correlation.
    """
    measured = load_errors(DENSE)
    lasts = 0.6  # of the variance
    errors = dataclasses.replace(
        measured,
        fresh=np.sqrt(1 - lasts) * measured.sd,
        outliers=np.zeros(7),
        slow_time=0.5,
        shear_gain=0.0,
        between=np.zeros(7),
    )
    true = np.array([0.1, -0.2, -0.7, 1e-3, 2e-3, 1e-4])
    here = errors.at(0.7)
    rng = np.random.default_rng(0)
    erring = SensingErrorSampler(errors)
    erring.start(rng)
    count = 20000
    estimated = np.array([erring.estimated(true, PERIOD, rng)[0].copy() for _ in range(count)])
    z = (estimated - true - errors.gain @ true - here.mean) / here.sd
    alone = count / (1 + 2 * lasts * errors.slow_time / PERIOD)
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(alone)
    assert np.abs(z.T @ z / count - errors.correlation).max() < 4 * np.sqrt(2 / alone)
    for lag in (1, 15, 60):
        reported = lasts * np.exp(-lag * PERIOD / errors.slow_time)
        assert (z[lag:] * z[:-lag]).mean() == pytest.approx(reported, abs=4 / np.sqrt(6 * alone))


def test_the_kernel_samples_as_the_formula_does():
    """The kernel samples w + G w + b(n) + e from the same random numbers, to the last digits of
    double precision.

    The covariance is the pipeline's at that load.
    """
    errors = dataclasses.replace(load_errors(DENSE), outliers=np.full(7, 0.5))
    true = np.array([0.1, -0.2, -0.4, 1e-3, 2e-3, 1e-4])
    spread = np.linalg.cholesky(errors.correlation)
    here = errors.at(0.4)
    erring = SensingErrorSampler(errors)
    erring.start(np.random.default_rng(1))
    sampled = np.random.default_rng(1)
    slow = spread @ sampled.standard_normal(6)
    factor = np.exp(here.between * (sampled.standard_normal() - here.between))
    gain = np.array([1, 1, 0, 0, 0, 0]) * errors.shear_gain * sampled.standard_normal()
    rng, again = np.random.default_rng(2), np.random.default_rng(2)
    kept = np.exp(-PERIOD / errors.slow_time)
    lasts = here.sd**2 - here.fresh**2
    untouched = np.minimum(lasts, errors.sd[0] ** 2 - errors.fresh[0] ** 2)
    sd = np.sqrt(untouched + factor**2 * (lasts - untouched))
    for _ in range(5):
        estimated, cov, _ = erring.estimated(true, PERIOD, rng)
        fresh, fast = again.standard_normal((2, 6)) @ spread.T
        slow = kept * slow + np.sqrt(1 - kept**2) * fresh
        size = errors.outlier_size if again.random() < 0.5 else 1.0
        error = sd * slow + size * here.fresh * fast
        requested = true + errors.gain @ true + gain * true + here.mean + error
        np.testing.assert_allclose(estimated, requested, rtol=1e-11, atol=1e-14)
        np.testing.assert_allclose(
            cov,
            np.outer(here.reported_sd, here.reported_sd) * errors.reported_correlation,
            rtol=1e-11,
        )


def test_between_loads_errors_are_linear_and_beyond_the_last_as_there():
    errors = load_errors(DENSE)
    low, high = errors.loads[2:4]
    midpoint = errors.at((low + high) / 2)
    np.testing.assert_allclose(midpoint.sd, (errors.sd[2] + errors.sd[3]) / 2, rtol=1e-12)
    np.testing.assert_array_equal(errors.at(99.0).sd, errors.sd[-1])
    assert parse_error_model(errors.table()).table() == errors.table()


def test_a_grasp_with_sampled_touch_is_held_states_its_level_and_is_the_same_again():
    results = [run_grasp(Scenario(controller="gentle", effects=SAMPLED, seed=5)) for _ in range(2)]
    first, again = (result.summary() for result in results)
    assert first["outcome"] == "held"
    assert not (first["mesh"] or first["pipeline"] or first["images"])
    assert first["hold_force_true_N"] == again["hold_force_true_N"]
    assert first["hold_force_N"] != first["hold_force_true_N"]  # a measurement


def test_without_a_pipeline_there_are_no_images_and_no_mesh():
    on = choose(DENSE, overrides=SAMPLED).on
    assert not on & {Effect.MESH, Effect.PIPELINE, Effect.IMAGES}
    for refused, message in (
        ("-pipeline", "needs the quasi-static"),
        ("-mesh,-pipeline,+images", "images are not used"),
    ):
        with pytest.raises(InputError, match=message):
            choose(DENSE, overrides=refused)


def test_a_user_of_the_pipeline_is_named():
    reads = Controller(Path("mine.py"), lambda _: None, reads=("contact_shape",))
    with (
        open_session(Scenario(effects=SAMPLED)) as session,
        pytest.raises(
            InputError, match=r"mine.py: REQUIRES: 'contact_shape' needs the effect 'pipeline'"
        ),
    ):
        session.run(reads, time_limit=1.0)
    with pytest.raises(InputError, match="in grasps only"):
        SimCamera(None, 0, frozenset({Effect.IMAGES}))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"paper16: .*bench error-model --sensor paper16"):
        load_errors(load_sensor("paper16"))
    other = dataclasses.replace(DENSE, membrane=dataclasses.replace(DENSE.membrane, thickness=4e-4))
    with pytest.raises(InputError, match="for another design"):
        load_errors(other)
