"""Tests of camera calibration by circles on a grid: intrinsics including k3 are recovered with
parts of the board missing."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from benchmarks.paper import marker_scenes
from mjtactile.calibrate.camera import BoardView, calibrate_camera
from mjtactile.calibrate.circle_board import CircleFinder, calibrate_from_circles, number_grid
from mjtactile.calibrate.intrinsics import LensFit
from mjtactile.cli import main
from mjtactile.core import optics
from mjtactile.core.errors import InputError
from tests.lenses import CAMERAS

SIZE = (640, 480)
CAMERA = optics.Camera(*SIZE, 610.0, 606.0, 325.3, 236.1, (-0.21, 0.09, 8e-4, -6e-4, 0.15))
PITCH = 8e-3
RADIUS = 3e-3
FINDER = CircleFinder(PITCH, RADIUS)


def board(rotation, shift, rows=9, columns=12):
    """Return the circles (N) of a board at a pose, by their grid index."""
    R = cv2.Rodrigues(np.asarray(rotation, float))[0]
    places = [(i, j) for j in range(rows) for i in range(columns)]
    center = np.array([columns - 1, rows - 1, 0]) / 2
    return places, [
        marker_scenes.Circle(R @ (PITCH * ((*place, 0) - center)) + shift, R[:, 2], RADIUS)
        for place in places
    ]


def poses(count, seed=3):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        z = rng.uniform(0.075, 0.1)
        yield (
            np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.3, 0.3)]),
            z * np.array([*rng.uniform(-0.1, 0.1, 2), 1.0]),
        )


def exact_view(pose, camera=CAMERA, noise_px=0.02, seed=0):
    """Return noisy centers of the image areas, those of the ellipses, by integration along the
    rims."""
    places, circles = board(*pose)
    uv = []
    for circle in circles:
        u, v = (rim := marker_scenes.rim_px(camera, circle, 256)).T
        cross = u * np.roll(v, -1) - np.roll(u, -1) * v
        uv.append(
            ((rim + np.roll(rim, -1, axis=0)) * cross[:, None]).sum(axis=0) / (3 * cross.sum())
        )
    uv = np.array(uv) + np.random.default_rng(seed).normal(0, noise_px, (len(uv), 2))
    inside = ((uv > 5) & (uv < np.array(SIZE) - 5)).all(axis=1)
    ids = np.array([(i + 500) * 1000 + j + 500 for i, j in places], dtype=np.int32)
    return BoardView(str(seed), ids[inside], uv[inside])


def test_intrinsics_and_k3_are_recovered_from_ellipse_centers():
    views = [exact_view(pose, seed=k) for k, pose in enumerate(poses(12))]
    fit = calibrate_from_circles(FINDER, views, SIZE)
    # 12 views of 90 points at 0.02 px: sd of the focal length is 0.04 px, by OpenCV's own
    # covariance; five of them
    truth = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    assert (np.abs(fit.K[[0, 1, 0, 1], [0, 1, 2, 2]] - truth) < 5 * fit.sd[:4] + 0.02).all() and (
        fit.sd[:4] < 0.3
    ).all()
    assert (
        fit.lens.coefficients[4] == pytest.approx(0.15, abs=5 * fit.sd[8])
        and fit.lens.coefficients[4] > 4 * fit.sd[8]
    )
    assert fit.rms < 0.04  # 0.028 is the noise of both coordinates
    # centers of the ellipses used as those of the circles
    plain = calibrate_camera(FINDER, views, SIZE, LensFit(k3=True))
    assert (np.abs(plain.K[[0, 1], [0, 1]] - truth[:2]) > 10 * plain.sd[:2]).all()


@pytest.mark.parametrize("model", ["rational_polynomial", "equidistant"])
def test_other_lens_models_are_recovered(model):
    """The projection is within 0.1 px of the ground truth in the area of the circles: 1000 points
    at 0.02 px. The coefficients of a rational polynomial are not unique, their projection is."""
    truth = replace(CAMERAS[model], fx=500.0, fy=505.0)
    views = [exact_view(pose, truth, seed=k) for k, pose in enumerate(poses(12))]
    fit = calibrate_from_circles(FINDER, views, SIZE, LensFit(model))
    assert fit.lens.model == model and fit.rms < 0.04 and fit.holdout_px < 0.05
    assert len(fit.sd) == 4 + len(fit.lens.coefficients)
    p = np.column_stack([np.mgrid[-4:5, -3:4].reshape(2, -1).T / 10, np.ones(63)])
    computed = fit.lens.distort(p[:, :2]) * fit.K[[0, 1], [0, 1]] + fit.K[:2, 2]
    off = computed - optics.project(truth, p)
    # a common shift is a rotation of the camera, which `frame` measures
    assert np.abs(off - off.mean(axis=0)).max() < 0.1
    if model == "equidistant":
        own = [fit.K[0, 0], fit.K[1, 1], fit.K[0, 2], fit.K[1, 2], *fit.lens.coefficients]
        right = [truth.fx, truth.fy, truth.cx, truth.cy, *truth.distortion]
        assert (np.abs(np.subtract(own, right)) < 5 * fit.sd).all()


def test_k3_is_left_out_where_the_images_do_not_show_it():
    without = replace(CAMERA, distortion=(*CAMERA.distortion[:4], 0.0))
    views = [exact_view(pose, without, seed=k) for k, pose in enumerate(poses(8))]
    assert calibrate_from_circles(FINDER, views, SIZE).lens.coefficients[4] == 0


def test_a_grid_is_numbered_with_missing_and_false_circles():
    rng = np.random.default_rng(0)
    places, circles = board((0.4, -0.5, 0.6), (0.0, 0.0, 0.12))
    uv = optics.project(CAMERA, np.array([c.p_C for c in circles]))
    keep = rng.permutation(len(uv))[:90]  # 18 are missing
    false_circles = rng.uniform((0, 0), (640, 60), (15, 2))
    found = number_grid(np.concatenate([uv[keep], false_circles]))
    indices = {k: place for k, place in found.items() if k < 90}
    assert len(indices) >= 85
    numbered = np.array(list(indices.values()))
    expected = np.array([places[keep[k]] for k in indices])
    # equal up to the origin and the directions of i and j: an affine map with determinant 1 or -1
    A = np.column_stack([expected, np.ones(len(expected))])
    solved = np.linalg.lstsq(A, numbered, rcond=None)[0]
    np.testing.assert_allclose(A @ solved, numbered, atol=1e-9)
    assert abs(abs(np.linalg.det(solved[:2])) - 1) < 1e-9


def test_the_command_writes_the_camera_file(tmp_path, capsys):
    """Three images are too few for a good result, but enough to write the rejections and their
    reasons."""
    for k, pose in enumerate(poses(3)):
        cv2.imwrite(
            str(tmp_path / f"{k}.png"),
            marker_scenes.image(CAMERA, board(*pose, rows=3, columns=6)[1], seed=k),
        )
    arguments = [
        "calibrate",
        "camera",
        str(tmp_path),
        "--from-circles",
        "--pitch-mm",
        "8",
        "--radius-mm",
        "3",
    ]
    assert main([*arguments, "--out", str(tmp_path / "camera.yaml"), "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert (
        result["views"] == 3
        and result["rms_px"] < 0.2
        and any("8 are needed" in reason for reason in result["reasons"])
    )
    assert yaml.safe_load(Path(result["file"]).read_text())["camera_matrix"]["data"][
        0
    ] == pytest.approx(610, rel=0.2)
    with pytest.raises(InputError, match="touch"):
        CircleFinder(5e-3, 3e-3)
    assert (
        main(
            [
                "calibrate",
                "camera",
                str(tmp_path),
                "--pitch-mm",
                "8",
                "--out",
                str(tmp_path / "b.yaml"),
            ]
        )
        == 2
    )
    assert "--from-circles" in capsys.readouterr().err
