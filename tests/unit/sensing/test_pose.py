"""The closed form against exact projections, its covariance against Monte Carlo, and the paper's
own equations."""

import numpy as np
import pytest

from benchmarks.paper import sine_rule
from mjtactile.core import geometry, optics
from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import CameraDesign
from mjtactile.core.types import Ellipses
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.pose import circles

CAMERA = optics.Camera(640, 480, 600.0, 610.0, 322.0, 236.0)
LENS = optics.Camera(640, 480, 600.0, 600.0, 319.5, 239.5, (-0.25, 0.08, 0.001, -0.002, 0.0))
PANE = optics.Camera(
    640, 480, 600.0, 600.0, 319.5, 239.5, (-0.05, 0.01, 0.0, 0.0, 0.0), 0.002, 1.52, 0.023
)
R = 0.0015


def random_poses(rng, count, tilt_deg=(0, 60)):
    z = rng.uniform(0.03, 0.06, count)
    p = np.stack(
        [rng.uniform(-0.35, 0.35, count) * z, rng.uniform(-0.3, 0.3, count) * z, z], axis=1
    )
    tilt = np.deg2rad(rng.uniform(*tilt_deg, count))
    angle = rng.uniform(0, 2 * np.pi, count)
    return p, np.stack(
        [np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), -np.cos(tilt)], axis=1
    )


def rims(p, n, count=64, radius=R):
    """Return points (N, count, 3) around circles."""
    e1 = np.cross(n, [0.0, 1.0, 0.0])
    e1 /= np.linalg.norm(e1, axis=1)[:, None]
    t = 2 * np.pi * np.arange(count)[:, None] / count
    return p[:, None] + radius * (np.cos(t) * e1[:, None] + np.sin(t) * np.cross(n, e1)[:, None])


def exact_cones(p, n, radius=R):
    """Return Q with x^T Q x = |x (n.p)/(n.x) - p|^2 (n.x)^2 - r^2 (n.x)^2: the cone over the
    circle."""
    d = np.einsum("ni,ni->n", n, p)[:, None, None]
    nn, np_, pn = (np.einsum("ni,nj->nij", x, y) for x, y in ((n, n), (n, p), (p, n)))
    return (
        d**2 * np.eye(3)
        - d * (np_ + pn)
        + (np.einsum("ni,ni->n", p, p) - radius**2)[:, None, None] * nn
    )


def as_ellipses(center, shape, cov=None):
    axes, angle = ellipse.axes_from_shape(shape)
    cov = np.tile(np.eye(5) * 1e-6, (len(center), 1, 1)) if cov is None else cov
    return Ellipses(
        center,
        axes,
        angle,
        ellipse.covariance_of_axes(cov, axes, angle),
        np.full(len(center), "ok"),
    )


def nearest(poses_p, poses_alt, truth):
    return np.minimum(
        np.linalg.norm(poses_p - truth, axis=-1), np.linalg.norm(poses_alt - truth, axis=-1)
    )


def test_closed_form_is_exact():
    p, n = random_poses(np.random.default_rng(0), 5000)
    Q = exact_cones(p, n)
    both_p, both_n = circles.circles_from_cones(Q, np.full(len(p), R))
    right = np.linalg.norm(both_p - p, axis=2).argmin(axis=0)
    each = np.arange(len(p))
    # error in m; 1e-9 mm. Double precision times the cone's condition number (Z/r)^2 ~ 2e3, squared
    # at most.
    assert np.linalg.norm(both_p[right, each] - p, axis=1).max() < 1e-12
    # rad; the normal loses half the digits where the two solutions meet (face-on)
    assert np.abs(both_n[right, each] - n).max() < 1e-6
    assert (np.einsum("kni,kni->kn", both_n, both_p) < 0).all(), "normals face the camera"
    # both solutions are equally far
    np.testing.assert_allclose(*np.linalg.norm(both_p, axis=2), rtol=1e-12)


def test_a_frontoparallel_circle_is_exact():
    p = np.array([[0.0, 0.0, 0.04]])
    n = np.array([[0.0, 0.0, -1.0]])
    both_p, both_n = circles.circles_from_cones(exact_cones(p, n), np.array([R]))
    # the normal's error is the square root of rounding, 1e-8, and the centre moves by r (r/Z) of
    # that
    np.testing.assert_allclose(both_p, np.stack([p, p]), atol=1e-11)
    np.testing.assert_allclose(both_n, np.stack([n, n]), atol=1e-6)


@pytest.mark.parametrize(
    ("camera", "bound"),
    [
        (CAMERA, 1e-11),  # exact but for rounding in the ellipse's shape
        # The image of a circle through a lens is not an ellipse. Its least-squares ellipse returns
        # the circle to second order in the bending over the marker: a few micrometers at the worst
        # corner, a third of the noise at its limit.
        (LENS, 4e-6),
        (PANE, 4e-6),
    ],
)
def test_through_lens_and_glass(camera, bound):
    p, n = random_poses(np.random.default_rng(1), 300, (5, 45))
    uv = optics.project(camera, rims(p, n, 256))
    center, shape = geometric_ellipses(uv)
    poses = circles.estimate_poses(as_ellipses(center, shape), camera, R)
    assert nearest(poses.p_CM, poses.p_CM_alt, p).max() < bound
    right = np.linalg.norm(poses.p_CM - p, axis=1) < np.linalg.norm(poses.p_CM_alt - p, axis=1)
    np.testing.assert_allclose(poses.uv_px[right], optics.project(camera, p)[right], atol=0.02)


def geometric_ellipses(uv):
    """Return least-squares ellipses (distance along normals) through dense boundary points (N, K,
    2), by Gauss-Newton."""
    center = uv.mean(axis=1)
    d = uv - center[:, None]
    moments = np.stack(
        [(d[..., 0] ** 2).mean(1), (d[..., 0] * d[..., 1]).mean(1), (d[..., 1] ** 2).mean(1)],
        axis=1,
    )
    shape = ellipse.shape_from_moments(moments / 2)
    for _ in range(12):
        p, q, s = ellipse.inverse_shape(shape).T[..., None]
        d = uv - center[:, None]
        e = np.stack([p * d[..., 0] + q * d[..., 1], q * d[..., 0] + s * d[..., 1]])
        rho = np.sqrt((e * e).sum(axis=0))
        e /= rho
        m = np.stack([p * e[0] + q * e[1], q * e[0] + s * e[1]])
        g = np.sqrt((m * m).sum(axis=0))
        m /= g
        T = np.stack([m[0], m[1], m[0] * e[0], m[0] * e[1] + m[1] * e[0], m[1] * e[1]], axis=2)
        arc = np.linalg.norm(np.roll(uv, -1, axis=1) - np.roll(uv, 1, axis=1), axis=2)[..., None]
        Tt = (T * arc).transpose(0, 2, 1)
        move = np.linalg.solve(Tt @ T, Tt @ ((rho - 1) / g)[..., None])[..., 0]
        center = center + move[:, :2]
        shape = shape + move[:, 2:]
    return center, shape


@pytest.mark.parametrize("camera", [CAMERA, LENS, PANE])
def test_covariance_agrees_with_monte_carlo(camera):
    rng = np.random.default_rng(2)
    p, n = random_poses(rng, 20, (15, 45))
    center, shape = geometric_ellipses(optics.project(camera, rims(p, n, 128)))
    # sd in px, about the effect of noise of 2 DN
    sd = np.array([0.003, 0.003, 0.004, 0.003, 0.004])
    predicted = circles.estimate_poses(
        as_ellipses(center, shape, np.tile(np.diag(sd**2), (20, 1, 1))), camera, R
    )
    repeats = 800
    moves = rng.normal(0, sd, (repeats, 20, 5))
    many = as_ellipses(
        (center + moves[..., :2]).reshape(-1, 2), (shape + moves[..., 2:]).reshape(-1, 3)
    )
    poses = circles.estimate_poses(many, camera, R)
    both = np.stack([poses.p_CM, poses.p_CM_alt]).reshape(2, repeats, 20, 3)
    normals = np.stack([poses.n_C, poses.n_C_alt]).reshape(2, repeats, 20, 3)
    ellipses = as_ellipses(center, shape, np.tile(np.diag(sd**2), (20, 1, 1)))
    for p_CM, n_C in ((predicted.p_CM, predicted.n_C), (predicted.p_CM_alt, predicted.n_C_alt)):
        cov_p, cov_n = circles.pose_covariances(ellipses, camera, p_CM, n_C)
        same = np.linalg.norm(normals - n_C, axis=3).argmin(axis=0)
        samples, turned = (
            np.take_along_axis(x, same[None, ..., None], axis=0)[0] for x in (both, normals)
        )
        for k in range(20):
            # the sample covariance of 800 draws is good to 5 % (1 sd); 3 x 20 of them, and 5 % for
            # curvature
            assert np.abs(np.cov(whitened(samples[:, k], cov_p[k])) - np.eye(3)).max() < 0.25
            across = np.stack(geometry.tangents(n_C[k]))  # a unit vector turns about two axes
            assert (
                np.abs(
                    np.cov(whitened(turned[:, k] @ across.T, across @ cov_n[k] @ across.T))
                    - np.eye(2)
                ).max()
                < 0.25
            )
    np.testing.assert_allclose(
        circles.pose_covariances(ellipses, camera, predicted.p_CM, predicted.n_C)[0],
        predicted.cov_p,
    )


def whitened(samples, cov):
    return np.linalg.solve(np.linalg.cholesky(cov), (samples - samples.mean(axis=0)).T)


def test_sine_rule_is_the_closed_form():
    p, n = random_poses(np.random.default_rng(3), 2000)
    uv = optics.project(CAMERA, rims(p, n, 64))
    center, shape = geometric_ellipses(uv)
    exact = as_ellipses(center, shape)
    for chord in ("major", "minor"):
        both = sine_rule.centres_by_sine_rule(exact, CAMERA, R, chord)
        # exact in theory; rounding grows with 1/angle^2 of the chord
        assert nearest(both[0], both[1], p).max() < 1e-10


def test_sine_rule_as_printed_and_in_its_stable_form():
    rng = np.random.default_rng(4)
    phi, omega = rng.uniform(0.005, 0.2, (2, 1000))
    stable = sine_rule.centre_distance(np.full(1000, R), phi, omega)
    np.testing.assert_allclose(
        sine_rule.centre_distance_as_printed(np.full(1000, R), phi, omega), stable, rtol=1e-9
    )
    # a chord seen square-on: CD = r/tan(phi)
    np.testing.assert_allclose(
        sine_rule.centre_distance(np.array([R]), np.array([0.04]), np.array([0.04])),
        R / np.tan(0.04),
    )


def test_radius_per_marker_scales_its_distance():
    p, n = random_poses(np.random.default_rng(5), 3, (20, 20))
    ellipses = as_ellipses(*geometric_ellipses(optics.project(CAMERA, rims(p, n))))
    one = circles.estimate_poses(ellipses, CAMERA, R)
    three = circles.estimate_poses(ellipses, CAMERA, np.array([1.0, 2.0, 3.0]) * R)
    np.testing.assert_allclose(three.p_CM, one.p_CM * np.array([[1.0], [2.0], [3.0]]), rtol=1e-12)
    design = CameraDesign(640, 480, 600.0, 610.0, 322.0, 236.0, distance=0.045)
    np.testing.assert_array_equal(circles.estimate_poses(ellipses, design, R).p_CM, one.p_CM)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, [1.0, 2.0], [[1.0]]])
def test_bad_radius(radius):
    ellipses = as_ellipses(np.array([[100.0, 100.0]] * 3), np.array([[9.0, 0.0, 8.0]] * 3))
    with pytest.raises(InputError, match="radius"):
        circles.estimate_poses(ellipses, CAMERA, radius)


def test_no_ellipses():
    none = as_ellipses(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 5, 5)))
    assert len(circles.estimate_poses(none, CAMERA, R)) == 0
