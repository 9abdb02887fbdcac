"""The compiled drawing of an image against the same in numpy, by another integral."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from mjtactile.core.design import load_sensor
from mjtactile.core.optics import Camera
from mjtactile.sim.rendering import renderer, shadows
from mjtactile.sim.rendering.renderer import Effects, Renderer
from tests.lenses import CAMERAS
from tests.numpy_pipeline import discs as numpy_discs

DESIGN = load_sensor("dense")


@pytest.fixture(scope="module")
def scene():
    p = DESIGN.markers.p_SM.copy()
    bump = np.exp(-((p[:, 0] - 4e-3) ** 2 + (p[:, 1] + 3e-3) ** 2) / 8e-3**2)
    slope = -2 * bump[:, None] * (p[:, :2] - [4e-3, -3e-3]) / 8e-3**2
    p[:, 2] -= 3e-3 * bump
    n = np.column_stack([3e-3 * slope, np.ones(len(p))])
    return p, n / np.linalg.norm(n, axis=1)[:, None]


@pytest.mark.parametrize(
    ("blur", "lens"),
    [
        (0.45, "plumb_bob"),
        (0.7, "plumb_bob"),
        (2.5, "plumb_bob"),
        (0.7, "rational_polynomial"),
        (0.7, "equidistant"),
    ],
)
def test_discs_and_opening(scene, blur, lens):
    """The kernel renders discs and opening as numpy does.

    Both round the positions of nodes to 1/512 px, each in its own coordinate. A pixel of a rim
    agrees to 1e-3 px over the blur, in units of its coverage, the mean of several nodes. Lens
    coefficients make the opening bulge; the image border cuts some discs.
    """
    camera = replace(
        Camera.from_design(DESIGN.camera, DESIGN.glass),
        distortion=CAMERAS[lens].distortion,
        distortion_model=lens,
    )
    p, n = scene
    aside = np.where(np.arange(len(p)) < 40, -1, 1)[:, None] * [8e-3, 5e-3, 0]
    p = np.concatenate(
        [p + aside - DESIGN.camera.p_SC, [[0, 0, -1], [np.nan, 0, 0.04], [1, 1, 0.05]]]
    )
    n = np.concatenate([n, [[0.0, 0, 1]] * 3])
    radius = np.linspace(0.3e-3, 1.4e-3, len(p))
    corners = np.array(
        [
            [-18e-3, -14e-3, 45e-3],
            [18e-3, -14e-3, 45e-3],
            [18e-3, 14e-3, 45e-3],
            [-18e-3, 14e-3, 45e-3],
        ]
    )
    for render, shape in (("render_discs", (p, n, radius)), ("render_opening", (corners,))):
        computed, reference = np.zeros((2, camera.height, camera.width), np.float32)
        for module, image in ((renderer, computed), (numpy_discs, reference)):
            getattr(module, render)(camera, *shape, blur, image)
        assert reference.max() > 0.99
        np.testing.assert_allclose(computed, reference, atol=2e-3 / blur**0.5)
        assert np.sqrt(np.mean((computed - reference) ** 2)) < 4e-4


def test_light_noise_and_rounding(scene):
    """The rendered image is (marker + contrast (1 - coverage)) light gain + noise, to single
    precision, 1e-7 of 255, and rounded."""
    sampled = Renderer(DESIGN, seed=4)
    gray = sampled.irradiance_image(*scene)
    coverage = np.zeros_like(gray)
    renderer.render_discs(
        sampled.camera,
        scene[0] - DESIGN.camera.p_SC,
        scene[1],
        sampled.radius,
        DESIGN.camera.blur_px,
        coverage,
    )
    light = sampled._light.field(scene[0])
    contrast = sampled._contrast(DESIGN.camera.blur_px)
    np.testing.assert_allclose(
        gray, (DESIGN.leds.marker_dn + contrast * (1 - np.minimum(coverage, 1))) * light, rtol=1e-6
    )
    dark = sampled.irradiance_image(*scene, effects=Effects(gain=0.5))
    np.testing.assert_allclose(dark, gray / 2, rtol=1e-6)
    for level, pixel in ((-7.0, 0), (0.4, 0), (0.6, 1), (254.4, 254), (300.0, 255)):
        assert (
            sampled.expose(np.full_like(gray, level), effects=Effects(noise_dn=0.0)).pixels == pixel
        ).all()


def test_bilinear_interpolation_equals_numpy():
    """The kernel equals scipy's interpolation, which excludes points beyond the grid, to
    rounding."""
    rng = np.random.default_rng(5)
    grid = rng.normal(size=(7, 9, 3))
    places = rng.uniform([-1, -2], [9.5, 8], (300, 2))
    within = np.clip(places, 0, [8, 6])[:, ::-1]
    expected = RegularGridInterpolator((np.arange(7), np.arange(9)), grid)(within)
    np.testing.assert_allclose(shadows.bilinear(grid, places), expected, atol=1e-14)
    flat = shadows.bilinear(grid[..., 1], places.reshape(30, 10, 2))
    np.testing.assert_allclose(flat, expected[:, 1].reshape(30, 10), atol=1e-14)
