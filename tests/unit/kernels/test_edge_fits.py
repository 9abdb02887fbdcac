"""Ellipses from the pixels of their edges, against the same estimator in numpy."""

from unittest.mock import patch

import numpy as np
import pytest

from mjtactile.sensing.image import edge_fit
from mjtactile.sensing.image import gamma as gamma_fit
from mjtactile.sensing.image.edge_bands import NeighborMarkers, pairs_within
from mjtactile.sensing.settings import DEFAULTS
from tests.numpy_pipeline import edges as numpy_edges


def render_dots(radius):
    """Return an image of 30 dots, one of them with glare, and their centers; 16 times
    oversampled."""
    rng = np.random.default_rng(2)
    pitch = 4 * radius
    center = np.stack(np.meshgrid(np.arange(1, 7), np.arange(1, 6)), axis=-1).reshape(-1, 2) * pitch
    center = center + rng.uniform(-0.5, 0.5, center.shape)
    height, width = (int(pitch * n) for n in (6, 7))
    v, u = (np.mgrid[: 4 * height, : 4 * width] + 0.5) / 4 - 0.5
    image = np.full(u.shape, 180.0)
    for x, y in center:
        image[(u - x) ** 2 / 1.1 + (v - y) ** 2 < radius**2] = 60
    image = image.reshape(height, 4, width, 4).mean(axis=(1, 3))
    for axis in (0, 1):
        image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    image[int(center[3, 1]) : int(center[3, 1]) + 2, int(center[3, 0]) :][:, :4] = 255
    return (image + rng.normal(0, 2, image.shape)).astype(np.float32), center


@pytest.mark.parametrize("radius", [3.0, 12.0])
@pytest.mark.parametrize("blur_sd", [np.inf, 0.1])
def test_ellipses_are_those_of_numpy(radius, blur_sd):
    """The steps of each marker end separately in the kernel. Two more follow: the results differ by
    less than a tenth of their standard deviation."""
    image, center = render_dots(radius)
    start = center + np.random.default_rng(3).uniform(-0.5, 0.5, center.shape)
    shape = np.tile([1.1 * radius, 0.0, radius], (len(center), 1))
    fits = []
    for fit_pixels in (edge_fit.fit_pixels, numpy_edges.fit_pixels):
        with patch.object(edge_fit, "fit_pixels", fit_pixels):
            fits.append(edge_fit.fit(image, start, shape, blur=0.9, blur_sd=blur_sd))
    computed, reference = fits
    np.testing.assert_allclose(computed.residual, reference.residual, rtol=2e-3)
    np.testing.assert_allclose(computed.blur, reference.blur, rtol=5e-3)
    np.testing.assert_allclose(computed.lost, reference.lost, rtol=0, atol=2e-3)
    sds = [np.sqrt(np.diagonal(fit.cov, axis1=1, axis2=2)) for fit in fits]
    np.testing.assert_allclose(*sds, rtol=5e-3)
    assert (np.abs(computed.center - reference.center) < 0.1 * sds[0][:, :2]).all()
    assert (np.abs(computed.shape - reference.shape) < 0.1 * sds[0][:, 2:]).all()
    clean = np.arange(len(center)) != 3
    assert np.abs(computed.center - center)[clean].max() < 6 * sds[0][clean, :2].max()


@pytest.mark.parametrize("robust", [False, True])
def test_equations_of_gamma_are_those_of_numpy(robust):
    """Sums of 400 products in single precision, relative to the norms of their factors."""
    image, center = render_dots(9.0)
    shape = np.tile([9.4, 0.1, 9.0], (len(center), 1))
    around = NeighborMarkers.of(center, shape, len(center), 5.0, DEFAULTS.edges)
    pixels, _, origin = edge_fit.gather(image, center, shape, around, 5.0)
    row = [60.0, 180.0, 1e-3, -2e-3, 0.8]
    theta = np.column_stack([center - origin, shape, np.tile(row, (len(center), 1))])
    computed = gamma_fit.equations(pixels, theta, 1.7, robust=robust)
    reference = numpy_edges.gamma_equations(pixels, theta, 1.7, robust=robust)
    norm = np.sqrt(np.diagonal(reference[0], axis1=1, axis2=2))
    by_gamma, _, residual, kept, *at_edge = np.sqrt(np.abs(reference[1][:, 20:])).T
    scales = [norm * residual[:, None], norm * by_gamma[:, None]]
    squares = np.square([by_gamma, np.sqrt(by_gamma * residual), residual, kept, *at_edge]).T
    assert (np.abs(computed[0] - reference[0]) < 1e-5 * norm[:, :, None] * norm[:, None]).all()
    assert (
        np.abs(computed[1] - reference[1]) < 1e-5 * np.concatenate([*scales, squares], axis=1)
    ).all()


def test_a_marker_outside_the_image_has_no_pixels():
    image, center = render_dots(3.0)
    center = np.array([center[0], [-500.0, 20.0]])
    fit = edge_fit.fit(image, center, np.tile([3.0, 0.0, 3.0], (2, 1)))
    assert abs(fit.center[0, 0] - center[0, 0]) < 0.1
    assert fit.pixels[1] == 0


def test_pairs_are_those_within_the_radius_of_the_first():
    """A search with the largest radius would give 10^7 pairs of 4800 dots next to one large
    outline."""
    rng = np.random.default_rng(5)
    points = rng.uniform(0, 100, (60, 2))
    radii = rng.uniform(0, 20, 40)
    radii[0] = 200.0
    i, j = pairs_within(points, points[:40], radii)
    distance = np.linalg.norm(points[:40, None] - points, axis=2)
    expected = (distance <= radii[:, None]) & (distance > 0)
    assert {*zip(i.tolist(), j.tolist(), strict=True)} == {*map(tuple, np.argwhere(expected))}
