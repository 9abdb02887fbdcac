"""`mjtactile bench perception`: how far from the physical limit the ellipses and poses are, how honest, how fast.

Images come from `bench.scenes`, which shares nothing with the detector. "centre error" takes the nearer of the two
solutions of the circle's pose (one image cannot tell them apart; the surface does), "as returned" the preferred one.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mjtactile import optics
from mjtactile.bench import scenes
from mjtactile.sensing import paper
from mjtactile.sensing.markers import detect
from mjtactile.sensing.pose import estimate_poses
from mjtactile.types import Array, CirclePoses, Ellipses

CAMERA = optics.Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
_STEP = np.array([1e-6, 1e-6, 1e-6, 1e-3, 1e-3])  # m and rad: numeric derivatives of the image
RADIUS, BLUR, NOISE, DARK, BRIGHT = 0.0015, 0.7, 2.0, 40.0, 180.0
TARGETS = {"mean_mm": (0.020, 0.010), "worst_mm": (0.10, 0.04), "depth_bias_mm": (0.010, 0.003),
           "cramer_rao_ratio": (2.0, 1.2), "chi2_per_dof": ((0.7, 1.4), (0.9, 1.1)), "detect_to_pose_80_ms": (2.5, 1.5)}


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Run all parts, write `perception.json`, `perception.md` and plots into `out`, and return the numbers."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    accuracy, errors = paper_like(images=4 if quick else 15)
    result = {
        "accuracy": accuracy,
        "methods": compare_methods(images=1 if quick else 5),
        "bias_against_blur": bias_against_blur(repeats=2 if quick else 10),
        "speed": speed(repeats=10 if quick else 60),
        "targets": TARGETS,
    }
    (out / "perception.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    (out / "perception.md").write_text(table(result), encoding="utf-8")
    plot(out, errors, result)
    return result


def paper_like(images: int, seed: int = 0) -> tuple[dict[str, float], dict[str, Array]]:
    """The paper's Fig. 6: `images` x 16 circles in random poses. Summary, and the errors it is made of."""
    rng = np.random.default_rng(seed)
    rows: dict[str, list[Array]] = {"error": [], "preferred": [], "chi2": [], "sd_z": [], "bound_z": []}
    missed = 0
    for _ in range(images):
        circles = scenes.random_circles(CAMERA, rng)
        image = scenes.image(CAMERA, circles, blur_px=BLUR, noise_dn=NOISE, dark_dn=DARK, bright_dn=BRIGHT,
                             seed=int(rng.integers(2**31)))
        poses = estimate_poses(detect(image, CAMERA), CAMERA, RADIUS)
        which, nearer, found = match(poses, circles)
        missed += int((~found).sum())
        truth = np.array([c.p_C for c in circles])[found]
        error = nearer[found] - truth
        cov = poses.cov_p[which[found]]
        rows["error"].append(error)
        rows["preferred"].append(poses.p_CM[which[found]] - truth)
        rows["chi2"].append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error) / 3)
        rows["sd_z"].append(np.sqrt(cov[:, 2, 2]))
        rows["bound_z"].append(np.array([np.sqrt(cramer_rao(CAMERA, c)[2, 2])
                                         for c, f in zip(circles, found, strict=True) if f]))
    e = {name: np.concatenate(parts) for name, parts in rows.items()}
    size = np.linalg.norm(e["error"], axis=1) * 1e3
    summary = {
        "circles": int(images * 16), "missed": missed, "mean_mm": size.mean(), "median_mm": np.median(size),
        "worst_mm": size.max(), "depth_bias_mm": e["error"][:, 2].mean() * 1e3,
        "depth_bias_sd_mm": e["error"][:, 2].std() * 1e3 / np.sqrt(len(size)),
        "cramer_rao_ratio": np.sqrt(np.mean((e["error"][:, 2] / e["bound_z"]) ** 2)),
        "cramer_rao_depth_um": np.median(e["bound_z"]) * 1e6, "chi2_per_dof": e["chi2"].mean(),
        "mean_as_returned_mm": np.linalg.norm(e["preferred"], axis=1).mean() * 1e3,
        "worst_as_returned_mm": np.linalg.norm(e["preferred"], axis=1).max() * 1e3,
    }  # fmt: skip
    return {key: float(value) for key, value in summary.items()}, e


def match(poses: CirclePoses, circles: Sequence[scenes.Circle]) -> tuple[Array, Array, Array]:
    """For each circle: the index (n,) of the nearest trusted pose, the nearer of its two centres (n, 3), and whether
    one is within a marker's radius (n,)."""
    truth = np.array([c.p_C for c in circles])
    trusted = np.flatnonzero(poses.status == "ok")
    if not len(trusted):
        return np.zeros(len(truth), int), truth * np.nan, np.zeros(len(truth), bool)
    both = np.stack([poses.p_CM[trusted], poses.p_CM_alt[trusted]])
    distance = np.linalg.norm(both[:, None] - truth[:, None], axis=3)  # (2, n, trusted)
    which = distance.min(axis=0).argmin(axis=1)
    each = np.arange(len(truth))
    solution = distance[:, each, which].argmin(axis=0)
    return trusted[which], both[solution, which], distance.min(axis=(0, 2)) < [c.radius for c in circles]


def cramer_rao(camera: optics.Camera, circle: scenes.Circle, *, blur_px: float = BLUR, noise_dn: float = NOISE,
               contrast: float = BRIGHT - DARK) -> Array:
    """Lowest possible covariance (5, 5) of centre (m) and tilt about two axes (rad), levels and blur known.

    From the Fisher information of the rendered image, by central differences of the renderer itself.
    """
    n = circle.n_C / np.linalg.norm(circle.n_C)
    first = np.cross(n, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    axes = (first, np.cross(n, first))
    rim = scenes.rim_px(camera, circle, 64)
    low, high = np.floor(rim.min(axis=0)) - 6, np.ceil(rim.max(axis=0)) + 6
    window = optics.Camera(int(high[0] - low[0]), int(high[1] - low[1]), camera.fx, camera.fy, camera.cx - low[0],
                           camera.cy - low[1], camera.distortion, camera.glass_thickness, camera.glass_index,
                           camera.glass_distance)

    def render(move: Array) -> Array:
        tilted = n + move[3] * axes[0] + move[4] * axes[1]
        moved = scenes.Circle(circle.p_C + move[:3], tilted, circle.radius)
        return contrast * scenes.coverage(window, [moved], blur_px).ravel()

    J = np.stack([(render(step) - render(-step)) / (2 * step.sum()) for step in np.diag(_STEP)], axis=1)
    scale = 1 / np.linalg.norm(J, axis=0)
    return np.linalg.inv((J * scale).T @ (J * scale)) * np.outer(scale, scale) * (noise_dn**2 + 1 / 12)


def compare_methods(images: int, seed: int = 1) -> dict[str, dict[str, float]]:
    """The same images by this package, the paper's sine rule on the same ellipses, and what OpenCV offers."""
    methods: dict[str, Callable[[Any], Array]] = {
        "closed form, sub-pixel (default)": lambda im: _both(estimate_poses(detect(im, CAMERA), CAMERA, RADIUS)),
        "sine rule on major axis, same ellipses": lambda im: paper.centres_by_sine_rule(detect(im, CAMERA), CAMERA, RADIUS),
        "sine rule on minor axis, same ellipses":
            lambda im: paper.centres_by_sine_rule(detect(im, CAMERA), CAMERA, RADIUS, "minor"),
        "findContours + fitEllipse + closed form": lambda im: _both(estimate_poses(opencv_ellipses(im), CAMERA, RADIUS)),
        "findContours + fitEllipse + sine rule": lambda im: paper.centres_by_sine_rule(opencv_ellipses(im), CAMERA, RADIUS),
        "SimpleBlobDetector + diameter": blob_centres,
    }
    rng = np.random.default_rng(seed)
    errors: dict[str, list[Array]] = {name: [] for name in methods}
    for _ in range(images):
        circles = scenes.random_circles(CAMERA, rng)
        image = scenes.image(CAMERA, circles, blur_px=BLUR, noise_dn=NOISE, seed=int(rng.integers(2**31)))
        truth = np.array([c.p_C for c in circles])
        for name, method in methods.items():
            both = method(image)
            nearest = np.argmin(np.linalg.norm(both[0][None] - truth[:, None], axis=2), axis=1)
            candidates = both[:, nearest] - truth
            errors[name].append(candidates[np.linalg.norm(candidates, axis=2).argmin(axis=0), np.arange(len(truth))])
    summary = {}
    for name, parts in errors.items():
        e = np.concatenate(parts) * 1e3
        size = np.linalg.norm(e, axis=1)
        summary[name] = {"mean_mm": float(size.mean()), "worst_mm": float(size.max()), "depth_bias_mm": float(e[:, 2].mean())}
    return summary


def _both(poses: CirclePoses) -> Array:
    return np.stack([poses.p_CM, poses.p_CM_alt])


def opencv_ellipses(image: Array) -> Ellipses:
    """What most people do: whole-pixel borders of a global threshold, `cv2.fitEllipse`."""
    _, binary = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
    borders, _ = cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    fits = [cv2.fitEllipse(b) for b in borders if len(b) > 20]
    center = np.array([f[0] for f in fits])
    axes = np.array([f[1] for f in fits]) / 2
    angle = np.deg2rad([f[2] for f in fits])
    swap = axes[:, 0] < axes[:, 1]
    return Ellipses(center, np.where(swap[:, None], axes[:, ::-1], axes), np.where(swap, angle + np.pi / 2, angle),
                    np.tile(np.eye(5) * 0.01, (len(fits), 1, 1)), np.full(len(fits), "ok"))


def blob_centres(image: Array) -> Array:
    """`cv2.SimpleBlobDetector`: a blob's middle and mean diameter as if every circle were face-on."""
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.filterByArea, parameters.minArea, parameters.maxArea = True, 30.0, 5e4
    parameters.filterByInertia = parameters.filterByConvexity = parameters.filterByCircularity = False
    found = cv2.SimpleBlobDetector_create(parameters).detect(image)
    uv, size = np.array([k.pt for k in found]), np.array([k.size for k in found])
    rays = optics.unproject(CAMERA, uv)
    p = rays / rays[:, 2:] * (CAMERA.fx * RADIUS / (size / 2))[:, None]
    return np.stack([p, p])


def bias_against_blur(repeats: int) -> list[dict[str, float]]:
    """Depth bias and spread of circles 40 mm away at 20 deg tilt, for several blurs; the classical bias beside it."""
    rows = []
    rng = np.random.default_rng(2)
    circles = scenes.random_circles(CAMERA, rng, depth=(0.04, 0.04), tilt_deg=(20, 20))
    for blur in (0.0, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0):
        exact = scenes.exact_image(CAMERA, circles, blur_px=blur, dark_dn=DARK, bright_dn=BRIGHT)
        errors = []
        for _ in range(repeats):
            image = np.clip(np.rint(exact + rng.normal(0, NOISE, exact.shape)), 0, 255).astype(np.uint8)
            _, nearer, found = match(estimate_poses(detect(image, CAMERA), CAMERA, RADIUS), circles)
            errors.append((nearer[:, 2] - 0.04)[found])
        e = np.concatenate(errors) * 1e6
        a = CAMERA.fx * RADIUS / 0.04
        rows.append({"blur_px": blur, "bias_um": float(e.mean()), "sd_um": float(e.std()),
                     "uncorrected_um": float(0.04e6 * (blur**2 + 1 / 12) / (2 * a * a)), "found": len(e)})
    return rows


def speed(repeats: int) -> list[dict[str, float]]:
    """Milliseconds of processor time from image to poses, one thread, against the number of markers; beside it
    SimpleBlobDetector."""
    rows = []
    for nv, nu, radius in ((4, 4, 0.0015), (8, 10, 0.0010), (11, 14, 0.0007), (14, 18, 0.0006)):
        circles = scenes.random_circles(CAMERA, np.random.default_rng(0), rows=nv, columns=nu, radius=radius,
                                        depth=(0.043, 0.047), tilt_deg=(0, 25))
        image = scenes.image(CAMERA, circles)
        ellipses = detect(image, CAMERA)
        rows.append({"markers": nv * nu, "found_ok": int((ellipses.status == "ok").sum()),
                     "detect_ms": _median_ms(lambda im=image: detect(im, CAMERA), repeats),
                     "pose_ms": _median_ms(lambda e=ellipses, r=radius: estimate_poses(e, CAMERA, r), repeats),
                     "blob_detector_ms": _median_ms(lambda im=image: blob_centres(im), max(3, repeats // 10))})
        rows[-1]["total_ms"] = rows[-1]["detect_ms"] + rows[-1]["pose_ms"]
    return rows


def _median_ms(call: Callable[[], Any], repeats: int) -> float:
    call()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        call()
        times.append(time.thread_time() - start)
    return float(np.median(times) * 1e3)


def table(result: dict[str, Any]) -> str:
    """The results as Markdown."""
    a = result["accuracy"]
    lines = ["# Perception", "", f"{a['circles']:.0f} circles, {a['missed']:.0f} missed; noise {NOISE:g} DN, blur {BLUR:g} px.",
             "", "| what | measured | at least | aim |", "|---|---|---|---|"]
    for key in ("mean_mm", "worst_mm", "depth_bias_mm", "cramer_rao_ratio", "chi2_per_dof"):
        lines.append(f"| {key} | {a[key]:.4f} | {TARGETS[key][0]} | {TARGETS[key][1]} |")
    eighty = next(row for row in result["speed"] if row["markers"] == 80)
    lines.append(f"| detect_to_pose_80_ms | {eighty['total_ms']:.2f} | 2.5 | 1.5 |")
    lines += ["", "| method | mean mm | worst mm | depth bias mm |", "|---|---|---|---|"]
    lines += [f"| {name} | {m['mean_mm']:.4f} | {m['worst_mm']:.4f} | {m['depth_bias_mm']:+.4f} |"
              for name, m in result["methods"].items()]
    lines += ["", "| blur px | bias um | sd um | uncorrected um |", "|---|---|---|---|"]
    lines += [f"| {r['blur_px']:g} | {r['bias_um']:+.2f} | {r['sd_um']:.2f} | {r['uncorrected_um']:.1f} |"
              for r in result["bias_against_blur"]]
    lines += ["", "| markers | detect ms | pose ms | total ms | SimpleBlobDetector ms | ratio |", "|---|---|---|---|---|---|"]
    lines += [f"| {r['markers']} | {r['detect_ms']:.2f} | {r['pose_ms']:.2f} | {r['total_ms']:.2f} | "
              f"{r['blob_detector_ms']:.1f} | {r['blob_detector_ms'] / r['total_ms']:.1f} |" for r in result["speed"]]
    return "\n".join(lines) + "\n"


def plot(out: Path, errors: dict[str, Array], result: dict[str, Any]) -> None:
    """`perception.png`: error against the bound, honesty of the covariance, bias against blur, time against markers."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(10, 7.5), constrained_layout=True)
    bound = errors["bound_z"] * 1e6
    axes[0, 0].plot(bound, np.abs(errors["error"][:, 2]) * 1e6, ".", ms=4)
    line = np.array([0.0, bound.max()])
    axes[0, 0].plot(line, line, "k-", lw=1, label="1 sd at the Cramer-Rao bound")
    axes[0, 0].plot(line, 2 * line, "k:", lw=1, label="2 sd")
    axes[0, 0].set(xlabel="Cramer-Rao sd of depth (um)", ylabel="|depth error| (um)")
    axes[0, 0].legend()
    normal = np.sort(errors["error"][:, 2] / errors["sd_z"])
    axes[0, 1].plot(np.sqrt(2) * _erfinv(2 * (np.arange(len(normal)) + 0.5) / len(normal) - 1), normal, ".", ms=4)
    axes[0, 1].plot([-3, 3], [-3, 3], "k-", lw=1)
    axes[0, 1].set(xlabel="normal quantile", ylabel="depth error / predicted sd")
    rows = result["bias_against_blur"]
    blur = [r["blur_px"] for r in rows]
    spread = [r["sd_um"] / np.sqrt(r["found"]) for r in rows]
    axes[1, 0].errorbar(blur, [r["bias_um"] for r in rows], spread, fmt="o-", label="measured")
    axes[1, 0].plot(blur, [r["uncorrected_um"] for r in rows], "--", label="without the correction")
    axes[1, 0].set(xlabel="blur (px)", ylabel="depth bias (um)")
    axes[1, 0].legend()
    counts = [r["markers"] for r in result["speed"]]
    axes[1, 1].plot(counts, [r["total_ms"] for r in result["speed"]], "o-", label="image to poses")
    axes[1, 1].plot(counts, [r["blob_detector_ms"] for r in result["speed"]], "s--", label="SimpleBlobDetector alone")
    axes[1, 1].set(xlabel="markers", ylabel="ms per image", ylim=(0, None))
    axes[1, 1].legend()
    figure.savefig(out / "perception.png", dpi=120)
    plt.close(figure)


def _erfinv(x: Array) -> Array:
    from scipy.special import erfinv

    return erfinv(x)
