"""What a chain's errors are fitted as: made-up rows of known spread."""

import numpy as np
import pytest

from benchmarks.learning import drawn


def test_one_grasp_that_errs_by_ten_times_is_not_what_all_are_drawn_with():
    """Twenty fingers of sd 5 mN, each of 400 images pressed by 0.5 N, whose factors have a
    logarithm of sd 0.3; one of 50 mN. The mean square over all would come to 12 mN; the model's sd
    is a lognormal's root mean square, 5 mN times exp(0.3^2), widened by the far one's share of the
    spread."""
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
    near = drawn._shares(np.full(20 * images, 0.5))
    mean, sd, factor, spread = drawn._by_grasps(error, near, rows)
    at = int(np.flatnonzero(drawn.LOADS == 0.5)[0])
    assert 5e-3 < sd[at, 2] < 8.5e-3 < np.sqrt((error[:, 2] ** 2).mean())
    assert not mean[:, :2].any()
    assert spread == pytest.approx(np.std(np.log(factors)), rel=0.1)
    assert np.corrcoef(factor, np.repeat(factors, images))[0, 1] > 0.99
