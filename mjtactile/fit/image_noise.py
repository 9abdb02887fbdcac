"""Light, noise and blur of a camera from its images of the flat membrane.

Light: gray = membrane_DN (1 - vignetting s). Here s is the normalized loss of LED light towards the
corners (docs/theory/rendering.md, L1). This is linear in membrane_DN and membrane_DN vignetting.
The same holds inside the markers with marker_DN. Noise: the sd of each pixel over images of the
same scene, minus that of rounding. Blur: the width of the marker edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Image
from mjtactile.sensing.image.candidates import find
from mjtactile.sensing.image.ellipse_fit import fit_candidates
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sim.rendering.led_illumination import Light

# variance of rounding to whole grey levels; and, in px^2, of a pixel's own width
_ROUNDING = 1 / 12
_SATURATED = 250  # DN
_EDGE_PX = 5.0  # distance from a marker's edge beyond which it has no effect
_BORDER = 1e-3  # margin inside the opening, m
_LEVEL_SD = 0.5  # deviation of grey levels of any scene from this law, DN


@dataclass(frozen=True, eq=False)
class ImageNoiseFit:
    """Values with sd by field of the sensor file, and the residual image.

    The fields are `camera.blur_px`, `camera.noise_DN`, `leds.membrane_DN`, `leds.marker_DN`,
    `leds.vignetting`. `residual` (H, W) is the mean image minus the fitted light, DN (NaN: not
    evaluated).
    """

    values: dict[str, tuple[float, float]]
    residual: Array


def fit_image_noise(design: SensorDesign, images: Sequence[Image]) -> ImageNoiseFit:
    """Fit light, noise and blur to images of the flat membrane, all of the same scene."""
    stack = np.stack([image.pixels for image in images]).astype(np.float32)
    mean = stack.mean(axis=0)
    values = _noise(stack, mean)
    blurs = np.array([_blur(image) for image in images])
    blur_sd = float(max(0.01, blurs.std() / np.sqrt(len(blurs))))
    values["camera.blur_px"] = float(np.median(blurs)), blur_sd
    light, residual = _light(design, mean)
    return ImageNoiseFit(values | light, residual)


def _noise(stack: Array, mean: Array) -> dict[str, tuple[float, float]]:
    if len(stack) < 2:
        return {}
    # differences of consecutive images, so that slow flicker is excluded
    change = np.diff(stack, axis=0)[:, (mean > 2) & (mean < _SATURATED)]
    change = change - np.median(change, axis=1, keepdims=True)
    variance = float(np.mean(change**2)) / 2
    noise = float(np.sqrt(max(variance - _ROUNDING, 0.0)))
    return {"camera.noise_DN": (noise, float(0.01 * np.sqrt(variance)))}


def _blur(image: Image) -> float:
    """Return the Gaussian sd of the optics, px, as a median over the markers.

    It is the edge width without the pixel's own width.
    """
    fit = fit_candidates(image.pixels, find(image.pixels, 3.0), DEFAULTS)
    return float(np.sqrt(max(np.median(fit.blur) ** 2 - _ROUNDING, 0.0)))


def _light(design: SensorDesign, mean: Array) -> tuple[dict[str, tuple[float, float]], Array]:
    camera = Camera.from_design(design.camera, design.glass)
    shape = 1 - Light(replace(design, leds=replace(design.leds, vignetting=1.0)), camera).field(
        design.markers.p_SM
    )
    away, inside = _areas(design, camera, mean.shape)
    good = mean < _SATURATED
    bright = away & good
    dark = inside & good
    if bright.sum() < 100 or dark.sum() < 100:
        return {}, np.full(mean.shape, np.nan)
    A = np.column_stack([np.ones(bright.sum()), -shape[bright]])
    level, slope = np.linalg.lstsq(A, mean[bright], rcond=None)[0]
    vignetting = float(np.clip(slope / level, 0.0, 1.0))
    field = 1 - vignetting * shape
    marker = float(np.mean(mean[dark] / field[dark]))
    residual = np.full(mean.shape, np.nan)
    residual[bright] = mean[bright] - level * field[bright]
    residual[dark] = mean[dark] - marker * field[dark]
    spread = float(np.ptp(shape[bright]))
    # the residual is a model error: it does not average out
    level_sd = max(_LEVEL_SD, float(np.nanstd(residual[bright])) / 3)
    return {
        "leds.membrane_DN": (float(level), level_sd),
        "leds.marker_DN": (marker, level_sd),
        "leds.vignetting": (vignetting, level_sd / (float(level) * spread)),
    }, residual


def _areas(design: SensorDesign, camera: Camera, size: tuple[int, ...]) -> tuple[Array, Array]:
    """Return masks (H, W) of membrane and of markers, both away from any edge."""
    center = optics.project(camera, design.markers.p_SM - design.camera.p_SC)
    v, u = np.indices(size)
    distance = np.full(size, np.inf)
    for cu, cv in center:
        near = (np.abs(u - cu) < 200) & (np.abs(v - cv) < 200)
        distance[near] = np.minimum(distance[near], np.hypot(u[near] - cu, v[near] - cv))
    radius = camera.fx * design.markers.radius / design.camera.distance
    ray = optics.unproject(camera, np.stack([u[::8, ::8], v[::8, ::8]], axis=-1).astype(float))
    xy = ray[..., :2] / ray[..., 2:] * design.camera.distance
    within = design.frame.inside(xy.reshape(-1, 2)).reshape(xy.shape[:-1]) > _BORDER
    opening = np.kron(within, np.ones((8, 8), bool))[: size[0], : size[1]]
    return opening & (distance > 1.15 * radius + _EDGE_PX), distance < 0.85 * radius - _EDGE_PX
