"""Tests of the compiled stages against the same estimators in numpy, on images of a membrane under
normal and shear load."""

from dataclasses import fields, replace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.optics import Camera
from mjtactile.sensing.image import candidates, ellipse_fit, markers
from mjtactile.sensing.pose import circles, marker_matching
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sim.rendering.renderer import Renderer
from tests.lenses import CAMERAS
from tests.numpy_pipeline import circles as numpy_circles
from tests.numpy_pipeline import identity as numpy_identity
from tests.numpy_pipeline import profiles as numpy_profiles

DESIGN = load_sensor("dense")


@pytest.fixture(scope="module")
def image():
    p = DESIGN.markers.p_SM.copy()
    bump = np.exp(-((p[:, 0] - 4e-3) ** 2 + (p[:, 1] + 3e-3) ** 2) / 8e-3**2)
    slope = -2 * bump[:, None] * (p[:, :2] - [4e-3, -3e-3]) / 8e-3**2
    p[:, 2] -= 3e-3 * bump
    n = np.column_stack([3e-3 * slope, np.ones(len(p))])
    return Renderer(DESIGN, seed=4).render(p, n / np.linalg.norm(n, axis=1)[:, None])


def test_ellipses_from_profiles(image):
    """The kernel fits the same ellipses as numpy.

    Sums of 1e5 grey levels in single precision lose some 1e-7; the sd of a center is 0.01 px.
    """
    found = candidates.find(image.pixels, 4.0)
    assert len(found) > 70
    computed, reference = (
        fit(image.pixels, found.center, found.shape)
        for fit in (ellipse_fit.fit_profiles, numpy_profiles.fit)
    )
    for field in fields(computed):
        a = getattr(computed, field.name)
        b = getattr(reference, field.name)
        np.testing.assert_allclose(a, b, rtol=2e-5, atol=1e-5 * np.abs(b).max(), err_msg=field.name)


@pytest.mark.parametrize(
    "camera",
    [
        Camera.from_design(DESIGN.camera, DESIGN.glass),
        Camera.from_design(DESIGN.camera),
        replace(Camera.from_design(DESIGN.camera, DESIGN.glass), distortion=(0.0,) * 5),
        replace(
            Camera.from_design(DESIGN.camera, DESIGN.glass),
            distortion=(-0.1, 0.02, 1e-3, -2e-3, 0.01),
        ),
        *(lens.behind_glass(2e-3, 1.52, 23e-3) for lens in CAMERAS.values()),
    ],
    ids=["as shipped", "no glass", "no lens", "every coefficient", *CAMERAS],
)
def test_poses_from_ellipses(image, camera):
    """Both work in double precision on numbers of order 1; the covariance goes through a 5 x 5
    solution."""
    ellipses = markers.detect(image, min_radius_px=4.0, settings=DEFAULTS)
    computed, reference = (
        module.estimate_poses(ellipses, camera, DESIGN.markers.radius)
        for module in (circles, numpy_circles)
    )
    for name in ("uv_px", "p_CM", "n_C", "p_CM_alt", "n_C_alt", "cov_p"):
        a = getattr(computed, name)
        b = getattr(reference, name)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11 * np.abs(b).max(), err_msg=name)
    for a, b in zip(
        *(
            module.pose_covariances(ellipses, camera, computed.p_CM_alt, computed.n_C_alt)
            for module in (circles, numpy_circles)
        ),
        strict=True,
    ):
        np.testing.assert_allclose(a, b, atol=1e-11 * np.abs(b).max())
    shape = np.column_stack(
        [ellipses.semi_axes_px[:, 0], 0 * ellipses.angle, ellipses.semi_axes_px[:, 1]]
    )
    cones = [module.cones(camera, ellipses.center_px, shape) for module in (circles, numpy_circles)]
    np.testing.assert_allclose(*cones, atol=1e-11 * np.abs(cones[1]).max())
    for a, b in zip(
        *(
            module.circles_from_cones(cones[1], np.full(len(shape), 1e-3))
            for module in (circles, numpy_circles)
        ),
        strict=True,
    ):
        np.testing.assert_allclose(a, b, atol=1e-11)


def test_identity():
    """The kernel assigns the same ids as numpy for any circles.

    Circles moved together and alone. Some are missing, doubled, unknown or shifted by up to more
    than a pitch.
    """
    layout = DESIGN.markers.p_SM
    rng = np.random.default_rng(3)
    pitch = DESIGN.markers.pitch_x
    for _ in range(200):
        expected = layout + rng.normal(0, 0.1 * pitch, layout.shape)
        together = rng.normal(0, 0.5 * pitch, 3) * rng.integers(2)
        p = expected + together + rng.normal(0, rng.choice([0.02, 0.3]) * pitch, layout.shape)
        p = p[rng.permutation(len(p))[: rng.integers(1, len(p) + 1)]]
        p = np.concatenate([p, p[:3] + 0.3 * pitch])
        p[rng.random(len(p)) < 0.05] = np.nan
        expected[rng.random(len(expected)) < rng.choice([0.0, 0.1, 1.0])] = np.nan
        computed, reference = (
            module.match(p, expected, layout) for module in (marker_matching, numpy_identity)
        )
        np.testing.assert_array_equal(computed, reference)
