"""Tests of lens models against OpenCV, which shares no code, and against numerical derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core import geometry, optics
from mjtactile.core.errors import InputError
from mjtactile.core.lens import MODELS, Lens
from mjtactile.core.optics import Camera
from tests.lenses import CAMERAS, opencv_pixels

every_model = pytest.mark.parametrize("model", MODELS)


def points(n=500, seed=0):
    """Return points 30-60 mm away that fill a field of view of 60 degrees."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.030, 0.060, n)
    return np.column_stack([rng.uniform(-0.6, 0.6, n) * z, rng.uniform(-0.5, 0.5, n) * z, z])


@every_model
def test_projection_is_opencvs(model):
    camera = CAMERAS[model]
    p = points()
    # both evaluate the same functions in float64: rounding of ~1e3 px
    np.testing.assert_allclose(optics.project(camera, p), opencv_pixels(camera, p), atol=1e-9)


def test_a_fisheye_is_opencvs_at_80_degrees():
    camera = CAMERAS["equidistant"]
    angle = np.linspace(0, np.radians(80), 50)
    p = np.column_stack([np.sin(angle), 0.3 * np.sin(angle), np.cos(angle)])
    uv = optics.project(camera, p)
    np.testing.assert_allclose(uv, opencv_pixels(camera, p), atol=1e-9)
    # r = tan(80 deg) = 5.7: an error of the image of 1e-13 is 30 times as large in it
    np.testing.assert_allclose(optics.unproject(camera, uv), geometry.unit(p), atol=1e-10)


@every_model
def test_unproject_inverts_the_lens(model):
    p = points()
    camera = CAMERAS[model]
    # 1e-10 of a unit ray is 6e-8 px: Newton's tolerance, and far below any pixel noise
    np.testing.assert_allclose(
        optics.unproject(camera, optics.project(camera, p)), geometry.unit(p), atol=1e-10
    )


@every_model
def test_the_jacobian_is_the_derivative(model):
    lens = CAMERAS[model].lens
    xy = points()[:, :2] / 0.05
    h = 1e-6
    for axis in range(2):
        step = h * np.eye(2)[axis]
        numeric = (lens.distort(xy + step) - lens.distort(xy - step)) / (2 * h)
        # central difference: h^2 truncation 1e-12 and cancellation 1e-16/h = 1e-10
        np.testing.assert_allclose(lens.jacobian(xy)[..., axis], numeric, atol=2e-9)
    # continuous on the axis
    np.testing.assert_allclose(lens.jacobian([0.0, 0.0]), lens.jacobian([1e-7, 0.0]), atol=1e-8)


def test_the_limits_of_the_models_agree():
    """A rational polynomial without denominator is plumb_bob; a fisheye of k = 0 is atan(r)."""
    xy = points()[:, :2] / 0.05
    k = CAMERAS["plumb_bob"].distortion
    np.testing.assert_array_equal(
        Lens("rational_polynomial", (*k, 0.0, 0.0, 0.0)).distort(xy),
        Lens("plumb_bob", k).distort(xy),
    )
    fisheye = Lens("equidistant")
    assert not fisheye.is_ideal and Lens().is_ideal
    np.testing.assert_allclose(fisheye.distort([1.0, 0.0]), [np.pi / 4, 0.0], atol=1e-15)


def test_undistort_refuses_points_outside_the_range_of_the_lens():
    folded = Lens("plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0))
    # r (1 - 0.3 r^2) is at most 0.7027 (at r = 1.054): no ideal point gives 0.71
    assert np.isnan(folded.undistort([[0.71, 0.0]])).all()
    xy = folded.undistort([[0.69, 0.0]])
    assert 0 < xy[0, 0] < 1.054
    # no ray before the camera is at 90 degrees or more to its axis
    assert np.isnan(Lens("equidistant").undistort([[1.6, 0.0]])).all()


@pytest.mark.parametrize(
    ("model", "coefficients", "message"),
    [
        ("equidistant", (0.1,) * 5, "4 numbers: k1, k2, k3, k4"),
        ("rational_polynomial", (0.1,) * 5, "8 numbers"),
        ("omnidirectional", (), "plumb_bob"),
    ],
)
def test_a_wrong_model_or_count_is_refused(model, coefficients, message):
    with pytest.raises(InputError, match=message):
        Camera(640, 480, 600.0, 600.0, 320.0, 240.0, coefficients, distortion_model=model)


def test_half_angle_of_view_depends_on_the_lens_model():
    """320 px of a fisheye of 407 px are 45 degrees; of a pinhole, tan = 320/407."""
    plain = Camera(640, 480, 407.4367, 407.4367, 319.5, 239.5)
    np.testing.assert_allclose(plain.half_view, [320 / 407.4367, 240 / 407.4367])
    fisheye = replace(plain, distortion=(), distortion_model="equidistant")
    np.testing.assert_allclose(fisheye.half_view, [1.0, np.tan(240 / 407.4367)], atol=1e-6)
