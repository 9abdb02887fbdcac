"""Pipeline from image to surface on the dense sensor: its cost, and surface errors under a ball.

The shape is computed here by projected over-relaxation of a membrane of uniform tension, under
pressure and over a rigid ball. `marker_scenes` renders the images. Neither shares code with the
detector or the fitted spline.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline

from benchmarks.paper import marker_scenes, sine_rule
from benchmarks.paper.marker_accuracy import CAMERA
from benchmarks.paper.marker_methods import blob_centres, opencv_ellipses
from benchmarks.perception.delaunay import reconstruct_delaunay
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.geometry import normal_from_slope
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Image
from mjtactile.sensing.image.markers import detect
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sensing.surface.surface import Spline, grid_of

# radius m, indentation m, 1/m
_BALL = 0.010
_DEEP = 0.003
_PRESSURE_OVER_TENSION = 20.0
_CELLS = 96  # cells of the relaxation along the length
_MIN_PX = 4.0  # minimum radius of circles; the blob detector has an area limit as well
# rows, columns, radius m
_LAYOUTS = ((4, 4, 0.0015), (8, 10, 0.0010), (11, 14, 0.0007), (14, 18, 0.0006))


class PressedMembrane:
    """Height z(x, y), m, of a membrane of uniform tension over the frame's opening.

    It sags under pressure towards -z or bulges to +z. A ball at (x, y), m, pushes it to -z.
    """

    def __init__(self, design: SensorDesign, x: float = 0.0, y: float = 0.0, deep: float = _DEEP):
        length = design.frame.length
        width = design.frame.width
        gx, gy = (
            np.linspace(-w / 2, w / 2, round(_CELLS * w / length) + 1) for w in (length, width)
        )
        far2 = (gx - x) ** 2 + (gy[:, None] - y) ** 2
        ball = np.where(
            far2 < 0.98 * _BALL**2, _BALL - deep - np.sqrt(np.maximum(_BALL**2 - far2, 0)), 1.0
        )
        dx2 = (gx[1] - gx[0]) ** 2
        dy2 = (gy[1] - gy[0]) ** 2
        z = np.zeros((len(gy), len(gx)))
        red = (np.add.outer(np.arange(len(gy)), np.arange(len(gx))) % 2).astype(bool)[1:-1, 1:-1]
        inner = (slice(1, -1), slice(1, -1))
        for _ in range(600):
            for half in (red, ~red):
                along = z[1:-1, 2:] + z[1:-1, :-2]
                across = z[2:, 1:-1] + z[:-2, 1:-1]
                mean = (along / dx2 + across / dy2 + _PRESSURE_OVER_TENSION) / (2 / dx2 + 2 / dy2)
                relaxed = z[inner] + 1.93 * (mean - z[inner])
                z[inner] = np.where(half, np.minimum(relaxed, ball[inner]), z[inner])
        self.spline = RectBivariateSpline(gy, gx, z)

    def __call__(self, x: Array, y: Array, dx: int = 0, dy: int = 0) -> Array:
        return self.spline(y, x, dx=dy, dy=dx, grid=False)


def view(design: SensorDesign, membrane: Callable[..., Array], seed: int) -> Image:
    """Render the design's camera image of its markers on `membrane`."""
    x = design.markers.p_SM[:, 0]
    y = design.markers.p_SM[:, 1]
    p = np.column_stack([x, y, membrane(x, y)]) - design.camera.p_SC
    n = normal_from_slope(membrane(x, y, 1, 0), membrane(x, y, 0, 1))
    n = np.where((np.einsum("ni,ni->n", n, p) > 0)[:, None], -n, n)
    radius = np.broadcast_to(design.markers.radius, (len(p),))
    circles = [marker_scenes.Circle(p[i], n[i], float(radius[i])) for i in range(len(p))]
    return Image(
        marker_scenes.image(Camera.from_design(design.camera, design.glass), circles, seed=seed),
        0.0,
    )


def pressed(frames: int, repeats: int) -> dict[str, Any]:
    """Measure surface errors of both methods, and the time from image to surface.

    Balls are pressed into the dense sensor at several positions and depths.
    """
    design = load_sensor("dense")
    rng = np.random.default_rng(6)
    membranes = [
        PressedMembrane(design, *rng.uniform(-0.004, 0.004, 2), deep=rng.uniform(0.0015, 0.0035))
        for _ in range(frames)
    ]
    images = [view(design, membrane, seed) for seed, membrane in enumerate(membranes)]
    errors: dict[str, list[Array]] = {"spline": [], "delaunay": []}
    seen = []
    x, y = np.meshgrid(*grid_of(design.frame, 0.0005))
    for membrane, image in zip(membranes, images, strict=True):
        sensing_pipeline = SensingPipeline(design)
        markers, _ = sensing_pipeline.detect_markers(sensing_pipeline.initial_state(), image)
        seen.append(len(markers))
        spline: Spline = sensing_pipeline.fitter.fit_spline(
            markers.p_SM, markers.cov_p, markers.n_S
        )
        truth = membrane(x, y)
        errors["spline"].append(spline.evaluate(x.ravel(), y.ravel()).reshape(x.shape) - truth)
        flat = reconstruct_delaunay(design, markers.p_SM)
        errors["delaunay"].append(flat.z - membrane(*np.meshgrid(flat.x, flat.y)))
    result: dict[str, Any] = {
        "frames": frames,
        "markers": design.markers.count,
        "min_detected": min(seen),
    }
    for name, parts in errors.items():
        result[f"{name}_rms_mm"] = float(np.sqrt(np.mean([np.mean(e**2) for e in parts])) * 1e3)
        result[f"{name}_worst_mm"] = float(max(np.abs(e).max() for e in parts) * 1e3)
    return result | {"pipeline_ms": _pipeline_ms(design, images, repeats)}


def _pipeline_ms(design: SensorDesign, images: list[Image], repeats: int) -> list[float]:
    """Measure the processor time of each run from image to surface, ms.

    The runs take the images in turn, as in a recording.
    """
    sensing_pipeline = SensingPipeline(design)
    markers, state = sensing_pipeline.detect_markers(sensing_pipeline.initial_state(), images[0])
    sensing_pipeline.fitter.fit(markers)
    spent = []
    for k in range(repeats):
        start = time.thread_time()
        markers, state = sensing_pipeline.detect_markers(state, images[k % len(images)])
        sensing_pipeline.fitter.fit(markers)
        spent.append(1e3 * (time.thread_time() - start))
    return spent


def speed(repeats: int) -> list[dict[str, float]]:
    """Measure the processor time from image to poses, ms, one thread, over the number of markers.

    Compared methods are `cv2.SimpleBlobDetector`, and `cv2.findContours` with `cv2.fitEllipse` and
    the paper's sine rule.
    """
    cv2.setNumThreads(1)
    rows = []
    for nv, nu, radius in _LAYOUTS:
        circles = marker_scenes.random_circles(
            CAMERA,
            np.random.default_rng(0),
            rows=nv,
            columns=nu,
            radius=radius,
            depth=(0.043, 0.047),
            tilt_deg=(0, 25),
        )
        image = marker_scenes.image(CAMERA, circles)
        ellipses = detect(image, CAMERA, min_radius_px=_MIN_PX)
        rows.append(
            {
                "markers": nv * nu,
                "found_ok": int((ellipses.status == "ok").sum()),
                "detect_ms": _median_ms(
                    lambda im=image: detect(im, CAMERA, min_radius_px=_MIN_PX), repeats
                ),
                "pose_ms": _median_ms(
                    lambda e=ellipses, r=radius: estimate_poses(e, CAMERA, r), repeats
                ),
                "blob_detector_ms": _median_ms(
                    lambda im=image: blob_centres(im), max(3, repeats // 10)
                ),
                "opencv_sine_ms": _median_ms(
                    lambda im=image, r=radius: sine_rule.centres_by_sine_rule(
                        opencv_ellipses(im), CAMERA, r
                    ),
                    max(3, repeats // 4),
                ),
            }
        )
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
