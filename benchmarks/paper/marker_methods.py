"""Comparison of this package, the paper's method and OpenCV on the same images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from benchmarks.paper import marker_scenes, sine_rule
from benchmarks.paper.marker_accuracy import BLUR, CAMERA, NOISE, RADIUS, match
from mjtactile.core import optics
from mjtactile.core.types import Array, CirclePoses, Ellipses
from mjtactile.sensing.image.markers import detect
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sensing.pose.circles_from_images import Neighbours, detect_circles


def compare_methods(images: int, seed: int = 1) -> dict[str, dict[str, float]]:
    """Compare this package, the paper's sine rule and OpenCV's methods on the same images.

    The sine rule uses the same ellipses as this package.
    """
    methods: dict[str, Callable[[Any], Array]] = {
        "closed form, sub-pixel (default)": lambda im: _both(
            estimate_poses(detect(im, CAMERA), CAMERA, RADIUS)
        ),
        "sine rule on major axis, same ellipses": lambda im: sine_rule.centres_by_sine_rule(
            detect(im, CAMERA), CAMERA, RADIUS
        ),
        "sine rule on minor axis, same ellipses": lambda im: sine_rule.centres_by_sine_rule(
            detect(im, CAMERA), CAMERA, RADIUS, "minor"
        ),
        "findContours + fitEllipse + closed form": lambda im: _both(
            estimate_poses(opencv_ellipses(im), CAMERA, RADIUS)
        ),
        "findContours + fitEllipse + sine rule": lambda im: sine_rule.centres_by_sine_rule(
            opencv_ellipses(im), CAMERA, RADIUS
        ),
        "SimpleBlobDetector + diameter": blob_centres,
    }
    rng = np.random.default_rng(seed)
    errors: dict[str, list[Array]] = {name: [] for name in methods}
    for _ in range(images):
        circles = marker_scenes.random_circles(CAMERA, rng)
        image = marker_scenes.image(
            CAMERA, circles, blur_px=BLUR, noise_dn=NOISE, seed=int(rng.integers(2**31))
        )
        truth = np.array([c.p_C for c in circles])
        for name, method in methods.items():
            both = method(image)
            nearest = np.argmin(np.linalg.norm(both[0][None] - truth[:, None], axis=2), axis=1)
            candidates = both[:, nearest] - truth
            errors[name].append(
                candidates[np.linalg.norm(candidates, axis=2).argmin(axis=0), np.arange(len(truth))]
            )
    summary = {}
    for name, parts in errors.items():
        e = np.concatenate(parts) * 1e3
        size = np.linalg.norm(e, axis=1)
        summary[name] = {
            "mean_mm": float(size.mean()),
            "worst_mm": float(size.max()),
            "depth_bias_mm": float(e[:, 2].mean()),
        }
    return summary


def _both(poses: CirclePoses) -> Array:
    return np.stack([poses.p_CM, poses.p_CM_alt])


def opencv_ellipses(image: Array) -> Ellipses:
    """Fit ellipses with the common method: whole-pixel contours of a global threshold,
    `cv2.fitEllipse`."""
    _, binary = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
    borders, _ = cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    fits = [cv2.fitEllipse(b) for b in borders if len(b) > 20]
    center = np.array([f[0] for f in fits])
    axes = np.array([f[1] for f in fits]) / 2
    angle = np.deg2rad([f[2] for f in fits])
    swap = axes[:, 0] < axes[:, 1]
    return Ellipses(
        center,
        np.where(swap[:, None], axes[:, ::-1], axes),
        np.where(swap, angle + np.pi / 2, angle),
        np.tile(np.eye(5) * 0.01, (len(fits), 1, 1)),
        np.full(len(fits), "ok"),
    )


def blob_centres(image: Array) -> Array:
    """Return circle centres from `cv2.SimpleBlobDetector`, as if every circle faced the camera.

    The position in the image is the center of the blob, the distance follows from its mean
    diameter.
    """
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.filterByArea = True
    parameters.minArea = 30.0
    parameters.maxArea = 5e4
    parameters.filterByInertia = parameters.filterByConvexity = parameters.filterByCircularity = (
        False
    )
    found = cv2.SimpleBlobDetector_create(parameters).detect(image)
    uv = np.array([k.pt for k in found])
    size = np.array([k.size for k in found])
    rays = optics.unproject(CAMERA, uv)
    p = rays / rays[:, 2:] * (CAMERA.fx * RADIUS / (size / 2))[:, None]
    return np.stack([p, p])


CHORD_END_PX = 0.05  # px: a good sub-pixel edge


def chord_noise(images: int, seed: int = 3) -> dict[str, dict[str, float]]:
    """Compare the errors caused by 0.05 px noise in edge points.

    The sine rule uses two chord ends. The closed form uses a conic through 64 such points. The
    ellipses are exact, so that no other error occurs; the closer of both solutions counts.
    """
    rng = np.random.default_rng(seed)
    errors: dict[str, list[Array]] = {}
    for _ in range(images):
        circles = marker_scenes.random_circles(CAMERA, rng)
        truth = np.array([c.p_C for c in circles])
        rims = np.stack([marker_scenes.rim_px(CAMERA, c, 64) for c in circles])
        exact = _ellipses(rims)
        ends = rng.normal(scale=CHORD_END_PX, size=(2, len(circles)))
        noisy = _ellipses(rims + rng.normal(scale=CHORD_END_PX, size=rims.shape))
        for name, both in (
            ("closed form, conic through 64 points", _both(estimate_poses(noisy, CAMERA, RADIUS))),
            (
                "sine rule, ends of the major chord",
                sine_rule.centres_by_sine_rule(exact, CAMERA, RADIUS, "major", ends),
            ),
            (
                "sine rule, ends of the minor chord",
                sine_rule.centres_by_sine_rule(exact, CAMERA, RADIUS, "minor", ends),
            ),
        ):
            errors.setdefault(name, []).append(
                np.linalg.norm(both - truth, axis=2).min(axis=0) * 1e3
            )
    joined = {name: np.concatenate(parts) for name, parts in errors.items()}
    return {
        name: {"mean_mm": float(e.mean()), "worst_mm": float(e.max())} for name, e in joined.items()
    }


def _ellipses(rims: Array) -> Ellipses:
    """Fit least-squares ellipses to points (N, K, 2), px."""
    midpoint = rims.mean(axis=1, keepdims=True)
    size = np.abs(rims - midpoint).max()
    x, y = np.moveaxis((rims - midpoint) / size, 2, 0)
    A = np.stack([x * x, 2 * x * y, y * y, x, y], axis=2)
    a, b, c, d, e = np.linalg.solve(A.transpose(0, 2, 1) @ A, A.sum(axis=1)[..., None])[..., 0].T
    M = np.stack([np.stack([a, b], axis=1), np.stack([b, c], axis=1)], axis=1)
    center = -0.5 * np.linalg.solve(M, np.stack([d, e], axis=1)[..., None])[..., 0]
    values, vectors = np.linalg.eigh(
        M / (1 + np.einsum("ni,nij,nj->n", center, M, center))[:, None, None]
    )
    return Ellipses(
        center * size + midpoint[:, 0],
        size / np.sqrt(values),
        np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]),
        np.tile(1e-3 * np.eye(5), (len(rims), 1, 1)),
        np.full(len(rims), "ok"),
    )


def board_from_name(images: int, seed: int = 4) -> dict[str, dict[str, float]]:
    """Compare single circles with `cv2.solvePnP` on a flat board of 16 circles.

    `cv2.solvePnP` needs the position of each circle on the board. It runs with the ellipses'
    centres and with the projected centres.
    """
    rng = np.random.default_rng(seed)
    x, y = (c.ravel() * 0.005 for c in np.meshgrid(np.arange(4) - 1.5, np.arange(4) - 1.5))
    layout = np.stack([x, y, np.zeros(16)], axis=1)
    errors: dict[str, list[Array]] = {}
    for _ in range(images):
        rotation = cv2.Rodrigues(np.deg2rad(rng.uniform(-30, 30, 3)))[0]
        truth = layout @ rotation.T + [0.0, 0.0, rng.uniform(0.04, 0.055)]
        circles = [marker_scenes.Circle(p, rotation @ [0.0, 0.0, -1.0], RADIUS) for p in truth]
        ellipses = detect(
            marker_scenes.image(CAMERA, circles, seed=int(rng.integers(2**31))), CAMERA
        )
        poses = estimate_poses(ellipses, CAMERA, RADIUS)
        which, nearer, found = match(poses, circles)
        errors.setdefault("each circle by itself", []).append((nearer - truth)[found])
        board, turned = _solve_board(layout[found], ellipses.center_px[which[found]])
        errors.setdefault("solvePnP, layout known, ellipse centres", []).append(
            board - truth[found]
        )
        # the board's normal selects the right one of a circle's two solutions
        n = turned @ [0.0, 0.0, -1.0]
        second = (poses.n_C_alt @ n > poses.n_C @ n)[:, None]
        uv = optics.project(CAMERA, np.where(second, poses.p_CM_alt, poses.p_CM))
        board, _ = _solve_board(layout[found], uv[which[found]])
        errors.setdefault("solvePnP, layout known, projected centres", []).append(
            board - truth[found]
        )
    joined = {
        name: np.linalg.norm(np.concatenate(parts), axis=1) * 1e3 for name, parts in errors.items()
    }
    return {
        name: {"mean_mm": float(e.mean()), "worst_mm": float(e.max())} for name, e in joined.items()
    }


def _solve_board(layout: Array, uv: Array) -> tuple[Array, Array]:
    """Solve the board's pose with `cv2.solvePnP`.

    Returns:
        The board's points (N, 3) in the camera frame, m, and its rotation (3, 3).
    """
    _, rotation, shift = cv2.solvePnP(layout, uv, CAMERA.K, np.zeros(5))
    angle = cv2.Rodrigues(rotation)[0]
    return layout @ angle.T + shift.T, angle


def small_circles(images: int, seed: int = 5) -> list[dict[str, Any]]:
    """Measure boards of 100 circles 4 px in radius, in images processed as by a cheap camera.

    Neighbor smoothing is on and off. The result is the scatter of the relative depth error, in
    percent. An error that is linear over the board is removed: processing moves all edges alike,
    which scales and tilts the whole. Boards are flat, on a cylinder, rippled, or with an own depth
    for each circle. The last one must remain unsmoothed.
    """
    rng = np.random.default_rng(seed)
    x, y = (c.ravel() for c in np.meshgrid(np.arange(10) - 4.5, np.arange(10) - 4.5))
    shapes = {
        "flat": 0 * x,
        "on a cylinder": 0.6 - np.sqrt(np.maximum(144 - x * x, 0)) + 12,
        "rippled": 0.25 * np.sin(x * 2 * np.pi / 6),
        "each at its own depth": rng.uniform(-1.5, 1.5, 100),
    }
    rows = []
    for name, height in shapes.items():
        scatter: dict[Neighbours, list[Array]] = {"never": [], "auto": []}
        shared = 0
        for _ in range(images):
            # the pitch is 4 radii: 16 px at 600 px of focal length are 37.5 pitches away
            rotation = cv2.Rodrigues(np.deg2rad(rng.uniform(-25, 25, 3) * [1, 1, 0.2]))[0]
            truth = 0.006 * (np.stack([x, y, height], axis=1) @ rotation.T + [0.0, 0.0, 37.5])
            circles = [marker_scenes.Circle(p, rotation @ [0.0, 0.0, -1.0], RADIUS) for p in truth]
            image = cheap_camera(
                marker_scenes.coverage(CAMERA, circles, 0.6), int(rng.integers(2**31))
            )
            for neighbours in scatter:
                located = detect_circles(image, CAMERA, RADIUS, neighbours=neighbours)
                shared += "depth" in located.shared
                good = located.poses.status == "ok"
                away = np.linalg.norm(
                    located.poses.uv_px[good] - optics.project(CAMERA, truth)[:, None], axis=2
                )
                found = away.min(axis=1) < 1.5  # px
                relative = located.poses.p_CM[good][away.argmin(axis=1), 2][found] / truth[found, 2]
                A = np.column_stack([x, y, np.ones(100)])[found]
                scatter[neighbours].append(
                    relative - A @ np.linalg.lstsq(A, relative, rcond=None)[0]
                )
        rows.append(
            {"surface": name, "depth_shared": f"{shared} of {images}"}
            | {
                f"scatter_{k}_percent": float(100 * np.std(np.concatenate(v)))
                for k, v in scatter.items()
            }
        )
    return rows


def cheap_camera(coverage: Array, seed: int) -> Array:
    """Simulate the color image (H, W, 3) of a cheap camera.

    The paper is over-exposed by a fifth. Noise, a Bayer mosaic, gamma, OpenCV's edge-aware
    demosaicing, sharpening and clipping follow.
    """
    light = 1.2 - 1.1 * coverage + np.random.default_rng(seed).normal(0, 0.01, coverage.shape)
    raw = np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    colour = cv2.cvtColor(raw, cv2.COLOR_BayerBG2BGR_EA).astype(np.float32)
    sharp = colour + 1.0 * (colour - cv2.GaussianBlur(colour, (0, 0), 1.2))
    return np.clip(np.rint(sharp), 0, 255).astype(np.uint8)
