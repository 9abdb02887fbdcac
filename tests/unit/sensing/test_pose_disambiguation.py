"""Tests of the selection of a circle's pose: by the circles around it, or by a prior with realistic
uncertainty."""

import numpy as np
import pytest

from benchmarks.paper import marker_scenes
from mjtactile.core import optics
from mjtactile.core.types import CirclePoses
from mjtactile.sensing.pose.circles_from_images import detect_circles
from mjtactile.sensing.pose.pose_disambiguation import prefer

CAMERA = optics.Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
R = 0.0025
PITCH = 0.009


def membrane(slope, bend, rows=5, columns=6):
    """Return circles on z = 0.11 m + slope . (x, y) + bend x^2/2, with the normals of the
    surface."""
    x, y = (
        PITCH * c.ravel()
        for c in np.meshgrid(
            np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2
        )
    )
    p = np.stack([x, y, 0.11 + slope[0] * x + slope[1] * y + bend * x * x / 2], axis=1)
    n = np.stack([slope[0] + bend * x, np.full_like(x, slope[1]), np.full_like(x, -1.0)], axis=1)
    return [marker_scenes.Circle(a, b / np.linalg.norm(b), R) for a, b in zip(p, n, strict=True)]


def right(found, circles):
    """Return True (N,) if the first normal is closer to the true one, and the confidence (N,), of
    the N trusted circles."""
    uv = optics.project(CAMERA, np.array([c.p_C for c in circles]))
    ok = np.flatnonzero(found.poses.status == "ok")
    which = np.linalg.norm(uv - found.poses.uv_px[ok, None], axis=2).argmin(axis=1)
    n = np.array([c.n_C for c in circles])[which]
    dot = (found.poses.n_C[ok] * n).sum(axis=1), (found.poses.n_C_alt[ok] * n).sum(axis=1)
    return dot[0] > dot[1], found.sure[ok]


def test_neighbours_on_a_membrane_decide_even_for_the_more_tilted_pose():
    """At the image edges the correct pose on a tilted membrane is often the pose with more tilt to
    the camera axis."""
    for slope, bend in (((0.5, 0.3), 0.0), ((-0.2, 0.4), 15.0)):
        circles = membrane(slope, bend)
        decided, sure = right(
            detect_circles(marker_scenes.image(CAMERA, circles), CAMERA, R), circles
        )
        assert len(decided) == 30 and decided.mean() > 0.96
        assert sure.mean() > 0.95


def test_an_error_that_all_normals_share_does_not_hide_the_plane():
    """All normals of a plane are off by 14 degrees, at a standard deviation of 0.3 degrees."""
    circles = membrane((0.8, 0.3), 0.0)
    p = np.array([c.p_C for c in circles])
    turned = np.array([c.n_C for c in circles]) + [0.25, 0.0, 0.0]
    near = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    ray = p / np.linalg.norm(p, axis=1, keepdims=True)
    mirrored = 2 * (near * ray).sum(axis=1, keepdims=True) * ray - near
    count = len(p)
    cov_p = np.tile(1e-10 * np.eye(3), (count, 1, 1))
    status = np.full(count, "ok")
    poses = CirclePoses(np.zeros((count, 2)), p, mirrored, p, near, cov_p, status)
    cov_n = np.tile(0.005**2 * np.eye(3), (2, count, 1, 1))
    better, _, sure = prefer(poses, cov_p, cov_n)
    np.testing.assert_array_equal(better.n_C, near)
    assert sure.min() > 0.95


@pytest.mark.slow
def test_confidence_for_independent_tilts_equals_the_success_rate():
    """16 circles each in 6 images, tilted by 0 to 60 degrees: the binomial sd of the fraction is
    0.045."""
    decided = []
    sure = []
    images = []
    for seed in range(6):
        circles = marker_scenes.random_circles(
            CAMERA, np.random.default_rng(seed), tilt_deg=(0, 60)
        )
        images.append(
            detect_circles(marker_scenes.image(CAMERA, circles, seed=seed), CAMERA, 0.0015)
        )
        one, two = right(images[-1], circles)
        decided = [*decided, *one]
        sure = [*sure, *two]
    assert len(decided) > 90
    assert abs(np.mean(decided) - np.mean(sure)) < 0.12
    assert 0.55 < np.mean(sure) < 0.85  # the confidence is low
    # neighbours without a common surface have no effect: the less tilted pose is first
    tilts = [np.stack([found.poses.n_C[:, 2], found.poses.n_C_alt[:, 2]]) for found in images]
    assert np.mean(np.concatenate([n[0] < n[1] for n in tilts])) > 0.97


def test_one_circle_alone_has_both_poses_with_their_covariances():
    """The closer pose is accurate within its standard deviations; those of the other pose equal
    `estimate_poses` when swapped."""
    truth = marker_scenes.Circle(
        np.array([0.012, 0.006, 0.05]), np.array([np.sin(0.6), 0.0, -np.cos(0.6)]), 0.0015
    )
    found = detect_circles(marker_scenes.image(CAMERA, [truth]), CAMERA, truth.radius)
    assert len(found.poses) == 1 and 0.5 <= found.sure[0] < 0.9
    error = np.stack([found.poses.p_CM[0], found.poses.p_CM_alt[0]]) - truth.p_C
    chi2 = [
        e @ np.linalg.solve(cov, e)
        for e, cov in zip(error, (found.poses.cov_p[0], found.cov_p_alt[0]), strict=True)
    ]
    assert min(chi2) < 16.3 < max(chi2)  # 0.1 % of a chi-square with 3 degrees of freedom
