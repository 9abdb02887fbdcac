"""Tests of a camera with images that blend several: the markers' noise reveals it, and a delayed
estimate has uncertainty in proportion to its change."""

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.types import Markers
from mjtactile.sensing.force.model_error import FitDiagnostics, ModelErrorVariance
from mjtactile.sensing.force.temporal_blending import BlendEstimator

SD = 2e-6  # marker noise, m


def shots(design, fraction, count=60, motion=None, missing=(), seed=3):
    """Yield the markers of `count` images. The fraction `fraction` of each is the previous image;
    `motion` (N, 3) m is the displacement per image."""
    rng = np.random.default_rng(seed)
    p = design.markers.p_SM
    ids = np.setdiff1d(np.arange(len(p)), missing)
    last = p + SD * rng.standard_normal(p.shape)
    for k in range(count):
        there = p if motion is None else p + k * motion
        last = fraction * last + (1 - fraction) * (there + SD * rng.standard_normal(p.shape))
        cov = np.broadcast_to(SD**2 * np.eye(3), (len(ids), 3, 3))
        yield Markers(ids, last[ids], np.tile([0.0, 0.0, 1.0], (len(ids), 1)), cov)


def blend(design, fraction, **how):
    found = None
    finder = BlendEstimator(design.markers.p_SM)
    for markers in shots(design, fraction, **how):
        found = finder.after(found, markers)
    return found


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
@pytest.mark.parametrize("fraction", [0.3, 0.5, 0.8])
def test_the_fraction_of_the_last_image_is_found(sensor, fraction):
    """Five sd: one sd of a correlation is 1 over the root of 20 images' 60 or 13 markers' three
    coordinates, and half of the share's."""
    design = load_sensor(sensor)
    free = 60 if sensor == "dense" else 13
    found = blend(design, fraction)
    assert found.fraction == pytest.approx(fraction, abs=5 * 2 / np.sqrt(20 * 3 * free))
    assert found.images == pytest.approx(found.fraction / (1 - found.fraction))


@pytest.mark.parametrize("missing", [(), (3, 40)])
def test_unblended_images_have_no_lag(missing):
    assert blend(load_sensor("dense"), 0.0, missing=missing).images == 0.0


def test_motion_is_not_lag():
    """Motion is not taken for blending, and the earlier estimate stays.

    The dent grows by four sd per image. Alone, this would resemble a repeated image.
    """
    design = load_sensor("dense")
    x, y = design.markers.p_SM[:, :2].T
    dent = np.zeros((len(x), 3))
    dent[:, 2] = -4 * SD * np.exp(-(x**2 + y**2) / (2 * 5e-3**2))
    assert blend(design, 0.0, motion=dent).images == 0.0
    finder = BlendEstimator(design.markers.p_SM)
    found = blend(design, 0.5)
    for markers in shots(design, 0.5, motion=dent, seed=4):
        found = finder.after(found, markers)
    assert found.fraction == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize("sds", [4, 8, 16, 64])
def test_slow_motion_of_a_few_markers_is_not_lag(sds):
    """A polynomial does not describe a small object that creeps next to the frame. The lag of 3 to
    19 images made the sd of a steady force 0.1 to 0.9 N."""
    design = load_sensor("dense")
    distance = np.linalg.norm(design.markers.p_SM[:, :2] - [0.0125, -0.0027], axis=1)
    dent = np.zeros_like(design.markers.p_SM)
    dent[distance < 4.5e-3, 2] = sds / 2 * SD
    dent[distance < 2e-3, 2] = -sds * SD
    assert blend(design, 0.0, motion=dent).images == 0.0


def test_a_lag_adds_the_uncertainty_of_the_change():
    """With a lag of one image, a change of 0.1 N since the last image adds 0.25 N of
    uncertainty."""
    design = load_sensor("dense")
    error_model = ModelErrorVariance(design, np.zeros((2, 2)))
    change = np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0])
    force = np.zeros((3, 2))
    force[2] = -0.5
    without, late = (
        error_model.variance(FitDiagnostics(force, change, np.zeros(3), 0.0, lag=lag))
        for lag in (0.0, 1.0)
    )
    assert late[2] - without[2] == pytest.approx(0.25**2)
    assert late[[0, 1, 3, 4, 5]] == pytest.approx(without[[0, 1, 3, 4, 5]])
