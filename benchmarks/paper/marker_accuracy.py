"""Pose errors of single circles relative to the Cramer-Rao bound, and a check of their covariance.

Images come from `marker_scenes`, which shares no code with the detector. The pose of a circle has
two solutions. "centre error" is that of the solution closer to the ground truth; the pipeline
selects it with the membrane surface. "as returned" is that of the preferred solution of one image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.paper import marker_scenes
from mjtactile.core import optics
from mjtactile.core.types import Array, CirclePoses
from mjtactile.sensing.image.markers import detect
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sensing.pose.circles_from_images import detect_circles

CAMERA = optics.Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
# steps of the numerical image derivatives, m and rad
_STEP = np.array([1e-6, 1e-6, 1e-6, 1e-3, 1e-3])
RADIUS = 0.0015
BLUR = 0.7
NOISE = 2.0
DARK = 40.0
BRIGHT = 180.0


def paper_like(images: int, seed: int = 0) -> tuple[dict[str, float], dict[str, Array]]:
    """Evaluate `images` x 16 circles in random poses, as in Fig. 6 of the paper.

    Return the summary and the values of each circle.
    """
    rng = np.random.default_rng(seed)
    rows: dict[str, list[Array]] = {
        name: [] for name in ("error", "preferred", "first", "sure", "chi2", "sd_z", "bound_z")
    }
    missed = 0
    for _ in range(images):
        circles = marker_scenes.random_circles(CAMERA, rng)
        image = marker_scenes.image(
            CAMERA,
            circles,
            blur_px=BLUR,
            noise_dn=NOISE,
            dark_dn=DARK,
            bright_dn=BRIGHT,
            seed=int(rng.integers(2**31)),
        )
        located = detect_circles(image, CAMERA, RADIUS)
        poses = located.poses
        which, nearer, found = match(poses, circles)
        missed += int((~found).sum())
        truth = np.array([c.p_C for c in circles])[found]
        error = nearer[found] - truth
        first = np.all(nearer[found] == poses.p_CM[which[found]], axis=1)
        cov = np.where(
            first[:, None, None], poses.cov_p[which[found]], located.cov_p_alt[which[found]]
        )
        rows["error"].append(error)
        rows["preferred"].append(poses.p_CM[which[found]] - truth)
        rows["first"].append(first)
        rows["sure"].append(located.sure[which[found]])
        rows["chi2"].append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error) / 3)
        rows["sd_z"].append(np.sqrt(cov[:, 2, 2]))
        rows["bound_z"].append(
            np.array(
                [
                    np.sqrt(cramer_rao(CAMERA, c)[2, 2])
                    for c, f in zip(circles, found, strict=True)
                    if f
                ]
            )
        )
    e = {name: np.concatenate(parts) for name, parts in rows.items()}
    size = np.linalg.norm(e["error"], axis=1) * 1e3
    summary = {
        "circles": int(images * 16),
        "missed": missed,
        "mean_mm": size.mean(),
        "median_mm": np.median(size),
        "worst_mm": size.max(),
        "depth_bias_mm": e["error"][:, 2].mean() * 1e3,
        "depth_bias_sd_mm": e["error"][:, 2].std() * 1e3 / np.sqrt(len(size)),
        "cramer_rao_ratio": np.sqrt(np.mean((e["error"][:, 2] / e["bound_z"]) ** 2)),
        "cramer_rao_depth_um": np.median(e["bound_z"]) * 1e6,
        "chi2_per_dof": e["chi2"].mean(),
        "mean_as_returned_mm": np.linalg.norm(e["preferred"], axis=1).mean() * 1e3,
        "worst_as_returned_mm": np.linalg.norm(e["preferred"], axis=1).max() * 1e3,
        "preferred_right": e["first"].mean(),
        "preferred_probability": e["sure"].mean(),
    }
    return {key: float(value) for key, value in summary.items()}, e


def match(
    poses: CirclePoses, circles: Sequence[marker_scenes.Circle]
) -> tuple[Array, Array, Array]:
    """Assign to each circle the index (n,) of the nearest trusted pose.

    Return also the closer of its two centres (n, 3), and True (n,) where it lies within a marker's
    radius.
    """
    truth = np.array([c.p_C for c in circles])
    trusted = np.flatnonzero(poses.status == "ok")
    if not len(trusted):
        return np.zeros(len(truth), int), truth * np.nan, np.zeros(len(truth), bool)
    both = np.stack([poses.p_CM[trusted], poses.p_CM_alt[trusted]])
    distance = np.linalg.norm(both[:, None] - truth[:, None], axis=3)  # (2, n, trusted)
    which = distance.min(axis=0).argmin(axis=1)
    each = np.arange(len(truth))
    solution = distance[:, each, which].argmin(axis=0)
    return (
        trusted[which],
        both[solution, which],
        distance.min(axis=(0, 2)) < [c.radius for c in circles],
    )


def cramer_rao(
    camera: optics.Camera,
    circle: marker_scenes.Circle,
    *,
    blur_px: float = BLUR,
    noise_dn: float = NOISE,
    contrast: float = BRIGHT - DARK,
) -> Array:
    """Return the Cramer-Rao bound, a covariance (5, 5) of centre (m) and tilt about two axes (rad).

    Grey levels and blur are known. The Fisher information follows from central differences of the
    rendered image.
    """
    n = circle.n_C / np.linalg.norm(circle.n_C)
    first = np.cross(n, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    axes = (first, np.cross(n, first))
    rim = marker_scenes.rim_px(camera, circle, 64)
    low = np.floor(rim.min(axis=0)) - 6
    high = np.ceil(rim.max(axis=0)) + 6
    window = replace(
        camera,
        width=int(high[0] - low[0]),
        height=int(high[1] - low[1]),
        cx=camera.cx - low[0],
        cy=camera.cy - low[1],
    )

    def render(move: Array) -> Array:
        tilted = n + move[3] * axes[0] + move[4] * axes[1]
        moved = marker_scenes.Circle(circle.p_C + move[:3], tilted, circle.radius)
        return contrast * marker_scenes.coverage(window, [moved], blur_px).ravel()

    J = np.stack(
        [(render(step) - render(-step)) / (2 * step.sum()) for step in np.diag(_STEP)], axis=1
    )
    scale = 1 / np.linalg.norm(J, axis=0)
    return (
        np.linalg.inv((J * scale).T @ (J * scale)) * np.outer(scale, scale) * (noise_dn**2 + 1 / 12)
    )


def bias_against_blur(repeats: int) -> list[dict[str, float]]:
    """Compute the depth bias and spread of circles for several blurs.

    The circles are 40 mm away at 20 deg tilt. The classical bias is given for comparison.
    """
    rows = []
    rng = np.random.default_rng(2)
    circles = marker_scenes.random_circles(CAMERA, rng, depth=(0.04, 0.04), tilt_deg=(20, 20))
    for blur in (0.0, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0):
        exact = marker_scenes.exact_image(
            CAMERA, circles, blur_px=blur, dark_dn=DARK, bright_dn=BRIGHT
        )
        errors = []
        for _ in range(repeats):
            image = np.clip(np.rint(exact + rng.normal(0, NOISE, exact.shape)), 0, 255).astype(
                np.uint8
            )
            _, nearer, found = match(estimate_poses(detect(image, CAMERA), CAMERA, RADIUS), circles)
            errors.append((nearer[:, 2] - 0.04)[found])
        e = np.concatenate(errors) * 1e6
        a = CAMERA.fx * RADIUS / 0.04
        rows.append(
            {
                "blur_px": blur,
                "bias_um": float(e.mean()),
                "sd_um": float(e.std()),
                "uncorrected_um": float(0.04e6 * (blur**2 + 1 / 12) / (2 * a * a)),
                "found": len(e),
            }
        )
    return rows
