"""Tests of the shape matrix and its conversions."""

import numpy as np

from mjtactile.sensing.image import ellipse
from tests.numpy_pipeline.ellipse import conic_from_shape, covariance_of_moves


def shapes(count=200):
    rng = np.random.default_rng(0)
    axes = np.sort(rng.uniform(2, 30, (count, 2)), axis=1)[:, ::-1]
    angle = rng.uniform(-np.pi / 2, np.pi / 2, count)
    return axes, angle, ellipse.shape_from_axes(axes, angle)


def test_axes_and_shape_are_inverse():
    axes, angle, shape = shapes()
    back_axes, back_angle = ellipse.axes_from_shape(shape)
    np.testing.assert_allclose(back_axes, axes, rtol=1e-12)
    np.testing.assert_allclose(back_angle, angle, atol=1e-9)  # loses digits where a is nearly b


def test_conic_vanishes_on_the_boundary():
    _, _, shape = shapes()
    center = np.random.default_rng(1).uniform(-50, 600, (len(shape), 2))
    points, _ = ellipse.boundary(center, shape, 17)
    x = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    value = np.einsum("nki,nij,nkj->nk", x, conic_from_shape(center, shape), x)
    assert np.abs(value).max() < 1e-8  # rounding times (600/2)^2


def test_second_moments_give_the_shape():
    _, _, shape = shapes()
    p, q, s = shape.T
    # of a filled ellipse: S^2/4
    second = np.stack([p * p + q * q, q * (p + s), q * q + s * s], axis=1) / 4
    np.testing.assert_allclose(ellipse.shape_from_moments(second), shape, rtol=1e-9, atol=1e-9)


def test_covariances_of_axes_and_shape_are_inverse_for_a_circle_too():
    axes, angle, _ = shapes(3)
    axes = axes.copy()
    axes[0, 1] = axes[0, 0]
    A = np.random.default_rng(2).normal(size=(3, 5, 5))
    cov = A @ A.transpose(0, 2, 1)
    back = ellipse.covariance_of_shape(ellipse.covariance_of_axes(cov, axes, angle), axes, angle)
    # the circle's floor of 1e-6 costs that much
    np.testing.assert_allclose(back, cov, rtol=1e-5, atol=1e-5)


def test_jacobian_is_the_derivative():
    axes, angle, _ = shapes(20)
    J = ellipse.axes_jacobian(axes, angle)
    h = 1e-6
    for column, (da, dangle) in enumerate((((h, 0), 0), ((0, h), 0), ((0, 0), h)), start=2):
        plus = ellipse.shape_from_axes(axes + da, angle + dangle)
        minus = ellipse.shape_from_axes(axes - np.array(da), angle - dangle)
        # central difference, O(h^2)
        np.testing.assert_allclose(J[:, 2:, column], (plus - minus) / (2 * h), atol=1e-6)


def test_moves_have_the_covariance_of_their_derivative():
    """Moves (w, V) of a boundary point e are e . w + e^T V e in units of the local radius; by
    central differences."""
    (_, _, shape), center, h = shapes(50), np.zeros((50, 2)), 1e-5
    J = np.empty((50, 5, 5))
    for k in range(5):
        ahead, behind = (
            np.concatenate(
                ellipse.moved(center, shape, np.tile(sign * h * np.eye(5)[k], (50, 1))), axis=1
            )
            for sign in (1, -1)
        )
        J[:, :, k] = (ahead - behind) / (2 * h)
    A = np.random.default_rng(1).normal(size=(50, 5, 5))
    cov = A @ A.transpose(0, 2, 1)
    np.testing.assert_allclose(
        covariance_of_moves(cov, shape), J @ cov @ J.transpose(0, 2, 1), rtol=1e-6, atol=1e-6
    )
