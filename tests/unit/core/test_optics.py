"""Tests of lens and glass against references that share no code: OpenCV's lens, and a vector ray
trace through the glass."""

import cv2
import numpy as np
import pytest

from mjtactile.core import geometry, optics
from mjtactile.core.design import load_sensor
from mjtactile.core.optics import Camera

LENS = Camera(640, 480, 600.0, 610.0, 320.5, 238.0, distortion=(-0.21, 0.08, 0.002, -0.003, -0.01))
GLASS = Camera(
    640,
    480,
    600.0,
    600.0,
    319.5,
    239.5,
    glass_thickness=2e-3,
    glass_index=1.52,
    glass_distance=23e-3,
)
BOTH = Camera(
    640, 480, 600.0, 610.0, 320.5, 238.0, (-0.21, 0.08, 0.002, -0.003, -0.01), 2e-3, 1.52, 23e-3
)


def points(n=500, seed=0):
    """Return points 30-60 mm away that fill more than the field of view."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.030, 0.060, n)
    return np.column_stack([rng.uniform(-0.6, 0.6, n) * z, rng.uniform(-0.5, 0.5, n) * z, z])


def snell(d, normal, n_from, n_to):
    """Refract by the vector form of Snell's law (unit directions d, one unit normal against
    them)."""
    ratio = n_from / n_to
    cos_in = -d @ normal
    cos_out = np.sqrt(1 - ratio**2 * (1 - cos_in**2))
    return ratio * d + (ratio * cos_in - cos_out)[:, None] * normal


def trace_to_depth(rays, camera, z):
    """Return the points of unit rays from the camera center at depth z, traced face by face."""
    normal = np.array([0.0, 0.0, -1.0])
    p = rays * (camera.glass_distance / rays[:, 2:])
    inside = snell(rays, normal, 1.0, camera.glass_index)
    p = p + inside * (camera.glass_thickness / inside[:, 2:])
    out = snell(inside, normal, camera.glass_index, 1.0)
    return p + out * ((z - p[:, 2]) / out[:, 2])[:, None]


def test_unproject_inverts_the_lens():
    p = points()
    # 1e-10 of a unit ray is 6e-8 px: Newton's tolerance, and far below any pixel noise
    np.testing.assert_allclose(
        optics.unproject(LENS, optics.project(LENS, p)), geometry.unit(p), atol=1e-10
    )


def test_projection_through_the_glass_agrees_with_a_ray_trace():
    p = points()
    rays = optics.unproject(GLASS, optics.project(GLASS, p))
    # both are exact: float64 rounding over four intersections; 1e-12 m is a nanometre's thousandth
    np.testing.assert_allclose(trace_to_depth(rays, GLASS, p[:, 2]), p, atol=1e-12)


def test_glass_and_lens_are_combined():
    p = points()
    rays = optics.unproject(BOTH, optics.project(BOTH, p))
    # 1e-10 rays over 0.06 m
    np.testing.assert_allclose(trace_to_depth(rays, BOTH, p[:, 2]), p, atol=1e-11)


def test_glass_shift_is_the_depth_error_of_a_model_without_glass():
    p = points()
    rays = optics.unproject(BOTH, optics.project(BOTH, p))
    shift = optics.glass_shift(BOTH, rays)
    apparent = p - np.column_stack([np.zeros((len(p), 2)), shift])
    np.testing.assert_allclose(geometry.unit(apparent), rays, atol=1e-10)
    # computed by hand, 2 mm of n = 1.52: 0.684 mm on the axis, t (1 - 1/n), and 0.801 mm at 31
    # degrees
    angle = np.deg2rad([0.0, 31.0])
    shift = optics.glass_shift(GLASS, np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)]))
    assert shift[0] == pytest.approx(2e-3 * (1 - 1 / 1.52), rel=1e-14)
    assert shift[1] == pytest.approx(0.80123e-3, abs=1e-8)


def test_without_glass_there_is_no_shift_and_invalid_points_are_nan():
    assert (optics.glass_shift(LENS, points()) == 0).all()
    assert np.isnan(optics.project(LENS, [[0.0, 0.0, -0.04]])).all()
    # inside the glass, which ends at 25 mm
    assert np.isnan(optics.project(GLASS, [[0.0, 0.0, 0.0249]])).all()
    np.testing.assert_array_equal(optics.project(GLASS, [[0.0, 0.0, 0.04]]), [[319.5, 239.5]])


def test_array_shapes_are_kept():
    grid = points(24).reshape(4, 6, 3)
    uv = optics.project(BOTH, grid)
    assert uv.shape == (4, 6, 2)
    assert optics.unproject(BOTH, uv).shape == (4, 6, 3)
    assert optics.project(BOTH, np.zeros((0, 3))).shape == (0, 2)
    assert optics.unproject(BOTH, np.zeros((0, 2))).shape == (0, 3)


def test_camera_of_a_design():
    design = load_sensor("dense")
    camera = Camera.from_design(design.camera, design.glass)
    assert camera.glass_thickness == design.glass.thickness
    assert camera.distortion == design.camera.distortion
    np.testing.assert_array_equal(camera.K, design.camera.K)


def test_rotations_agree_with_their_frames():
    rng = np.random.default_rng(1)
    w = rng.normal(size=(50, 3))
    w[0] = 0
    w[1] = 1e-9
    R = geometry.rotation_from_vector(w)
    reference = np.array([cv2.Rodrigues(v)[0] for v in w])
    np.testing.assert_allclose(R, reference, atol=1e-14)  # rounding
    n = geometry.unit(rng.normal(size=(50, 3)))
    a, b = geometry.tangents(n)
    triad = np.stack([a, b, n], axis=-1)
    np.testing.assert_allclose(
        np.swapaxes(triad, -1, -2) @ triad, np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(triad), 1, atol=1e-14)
    p = rng.normal(size=(7, 3))
    np.testing.assert_allclose(
        geometry.transform(R[2].T, -R[2].T @ w[2], geometry.transform(R[2], w[2], p)), p, atol=1e-14
    )


def test_normals_and_slopes_are_inverse():
    slope = np.random.default_rng(2).normal(size=(20, 2))
    n = geometry.normal_from_slope(slope[:, 0], slope[:, 1])
    assert (n[:, 2] < 0).all()  # towards the camera
    np.testing.assert_allclose(geometry.slope_from_normal(n), slope, atol=1e-14)
    assert np.isnan(geometry.unit([0.0, 0.0, 0.0])).all()
