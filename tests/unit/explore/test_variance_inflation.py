"""Tests of the inflation of a surface's variance beyond its Gaussian's, from touches that the
others did not predict."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag, cho_factor
from scipy.spatial.transform import Rotation

from mjtactile.explore.surface_fusion import fuse
from mjtactile.explore.surface_patch import Patch
from mjtactile.explore.surface_posterior import excess

TOUCHES, EACH = 5, 4
PARTS = [slice(EACH * k, EACH * (k + 1)) for k in range(TOUCHES)]


@pytest.fixture(scope="module")
def model():
    """Provide covariances (20, 20) mm^2 of a surface and of its touches."""
    rng = np.random.default_rng(11)
    slopes = rng.normal(size=(TOUCHES * EACH, 3))
    surface = slopes @ slopes.T
    heights = [0.04 + 0.01 * k for k in range(TOUCHES)]
    noise = block_diag(*(h * np.ones((EACH, EACH)) + 0.01 * np.eye(EACH) for h in heights))
    return surface, noise


def test_inflation_is_the_leave_one_out_error_of_each_touch(model):
    """Leaves each touch out in turn, and conditions on the others: no inverse of all at once."""
    surface, noise = model
    found = 3 * np.random.default_rng(4).multivariate_normal(np.zeros(20), surface + noise)
    inflated = noise.copy()
    inflated[PARTS[2], PARTS[2]] += 1.0  # down-weighted; yet it counts with its stated noise
    squares = []
    for part in PARTS:
        others = np.setdiff1d(np.arange(20), np.arange(20)[part])
        known = surface[np.ix_(others, others)] + inflated[np.ix_(others, others)]
        gain = np.linalg.solve(known, surface[others, part]).T
        predicted = (gain @ found[others]).mean()
        open_ = (surface[part, part] - gain @ surface[others, part]).mean()
        off = found[part].mean() - predicted
        squares.append(off**2 / (open_ + noise[part, part].mean()))
    assert (
        sum(squares) > TOUCHES
    )  # three times the stated noise: otherwise only the floor of 1 shows
    reported = excess(cho_factor(surface + inflated, lower=True), found, inflated, noise, PARTS)
    # the same algebra: rounding is left
    mean = (2 + sum(squares)) / (2 + TOUCHES)
    assert reported == pytest.approx(1 + 2 * (mean - 1), rel=1e-8)


def test_predicted_touches_do_not_inflate_the_variance(model):
    surface, noise = model
    factor = cho_factor(surface + noise, lower=True)
    assert excess(factor, np.zeros(20), noise, noise, PARTS) == 1.0
    assert excess(factor, np.ones(20), noise, noise, []) == 1.0


def ball_patch(way, radius_mm):
    """Return nine points on a ball about the origin, with the stated error of a good touch."""
    rotation = Rotation.align_vectors(way[None], np.array([[0.0, 0.0, 1.0]]))[0]
    u, v = (2e-3 * grid.ravel() for grid in np.meshgrid([-1.0, 0, 1], [-1.0, 0, 1]))
    radius = 1e-3 * radius_mm
    local = np.column_stack([u, v, np.sqrt(radius**2 - u**2 - v**2)])
    return Patch(rotation.apply(local), np.zeros((0, 3)), way, "smooth", 0.3)


@pytest.mark.slow
def test_contradicting_touches_widen_the_uncertainty_everywhere(two_families):
    """A ball touched in six places; then every other touch found 0.3 mm less: of no family."""
    directions = np.random.default_rng(2).normal(size=(6, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    agreed = fuse([ball_patch(direction, 12.0) for direction in directions])[0]
    assert agreed.excess == pytest.approx(1.0)
    uneven = [ball_patch(direction, 12.0 - 0.3 * (k % 2)) for k, direction in enumerate(directions)]
    disagreed = fuse(uneven)[0]
    assert disagreed.excess > 2
    # 1.8 by its square root, and 0.04 mm common to all touches; without it 1.2, by the values alone
    place = 12e-3 * np.random.default_rng(3).normal(size=(50, 3))
    place *= 12e-3 / np.linalg.norm(place, axis=1)[:, None]
    assert np.median(disagreed.distance_sd(place)) > 1.6 * np.median(agreed.distance_sd(place))
