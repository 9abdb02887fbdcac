"""Tests of border moments and of the validation of candidates and fits against numpy, on images and
on random values."""

import re
from dataclasses import fields

import cv2
import numpy as np
import pytest

from mjtactile.kernels import build
from mjtactile.sensing.image import candidates, ellipse, fit_validation
from mjtactile.sensing.image.candidates import Candidates
from mjtactile.sensing.image.edge_fit import EdgeFit
from mjtactile.sensing.image.ellipse_fit import as_ellipses
from mjtactile.sensing.settings import DEFAULTS, MarkerSettings
from tests.numpy_pipeline import candidates as numpy_candidates

SIZE = (480, 640)


def test_settings_are_in_the_order_of_the_c_struct():
    text = (build.FOLDER / "candidates.c").read_text()
    struct = re.search(r"typedef struct \{\s*double ([^;]*);\s*\} MarkerSettings;", text)
    assert struct and re.findall(r"\w+", struct.group(1)) == [
        field.name for field in fields(MarkerSettings)
    ]


def test_image_moments_equal_numpy():
    """Sums of integers to the fourth power, in double precision."""
    rng = np.random.default_rng(0)
    image = np.zeros(SIZE, np.uint8)
    for _ in range(60):
        x, y, a, b = rng.uniform([0, 0, 1, 1], [640, 480, 30, 30])
        cv2.ellipse(image, (int(x), int(y)), (int(a), int(b)), rng.uniform(0, 180), 0, 360, 255, -1)
    borders, _ = cv2.findContours(image, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    counts = np.array([len(border) for border in borders])
    computed = candidates._moments(np.concatenate(borders), counts, SIZE)
    reference = numpy_candidates.moments(np.concatenate(borders), counts, SIZE)
    np.testing.assert_array_equal(computed.cut, reference.cut)
    assert computed.cut.any() and not computed.cut.all()
    for name in ("center", "shape", "misfit"):
        np.testing.assert_allclose(
            getattr(computed, name), getattr(reference, name), rtol=1e-9, atol=1e-9
        )


def sampled(rng, n):
    """Sample fits and candidates from which they may have started: good ones, with one fault after
    another."""
    axes = np.sort(rng.uniform(3, 30, (n, 2)))[:, ::-1] * rng.choice([1.0, 1.0, 1.0, 0.2], (n, 1))
    axes[:, 1] *= rng.choice([1.0, 1.0, 0.12], n)
    shape = ellipse.shape_from_axes(axes, rng.uniform(-1.5, 1.5, n))
    center = rng.uniform([0, 0], [640, 480], (n, 2))
    root = rng.normal(0, rng.choice([0.01, 0.3, 3.0], (n, 1, 1)), (n, 5, 5))
    contrast = rng.uniform(-20, 150, n)
    residual = rng.choice([1.0, 2.0, 40.0, 1500.0], n, p=[0.6, 0.3, 0.08, 0.02])
    inside = rng.uniform(10, 60, n)
    fit = EdgeFit(
        center,
        shape,
        root @ root.transpose(0, 2, 1),
        inside,
        inside + contrast,
        rng.uniform(0.4, 3, n),
        residual,
        np.full(n, 48.0),
        rng.uniform(0, 0.35, n),
        rng.uniform(0, 0.08, n),
    )
    start = center + rng.normal(0, rng.choice([0.2, 5.0], (n, 1), p=[0.8, 0.2]), (n, 2))
    found = Candidates(
        start,
        shape * rng.normal(1, rng.choice([0.02, 0.3], (n, 1)), (n, 1)),
        rng.uniform(0, 8, n) ** 2 / 10,
        rng.random(n) < 0.1,
    )
    return fit, found


@pytest.mark.parametrize("polarity", ["dark", "bright"])
def test_validation_equals_numpy(polarity):
    observed = set()
    for seed in range(30):
        fit, found = sampled(
            np.random.default_rng(seed), int(np.random.default_rng(seed).integers(0, 120))
        )
        for minimum in (1.5, 4.0):
            args = found, minimum, DEFAULTS.markers
            np.testing.assert_array_equal(
                fit_validation.implausible(*args), numpy_candidates.implausible(*args)
            )
            args = fit, found, polarity, SIZE, minimum, DEFAULTS.markers
            (status, keep), (requested, keep_requested) = (
                fit_validation.validate_fits(*args),
                numpy_candidates.validate_fits(*args),
            )
            np.testing.assert_array_equal(status, requested)
            np.testing.assert_array_equal(keep, keep_requested)
            observed |= set(status)
    assert polarity == "bright" or observed == set(fit_validation.STATUSES)


def test_semi_axes():
    fit, _ = sampled(np.random.default_rng(7), 50)
    ellipses = as_ellipses(fit, np.full(50, "ok"))
    axes, angle = ellipse.axes_from_shape(fit.shape)
    np.testing.assert_allclose(ellipses.semi_axes_px, axes, rtol=1e-12)
    np.testing.assert_allclose(ellipses.angle, angle, rtol=1e-12)
    np.testing.assert_allclose(
        ellipses.cov, ellipse.covariance_of_axes(fit.cov, axes, angle), rtol=1e-9, atol=1e-12
    )
