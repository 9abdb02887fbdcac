"""Test images with known circle poses, without the sensing pipeline's ellipse, conic or edge
models.

Each circle's rim is projected point by point through glass and lens. Scan lines fill the polygon,
with exact coverage along each line, on a grid `SUPER` times finer than the pixels. The optical blur
acts on the fine grid, and the pixel's area integrates it. Light, noise and rounding follow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import optics
from mjtactile.core.types import Array

SUPER = 8  # fine cells per pixel
_LINES = 4  # scan lines per fine cell; the leftover error of a marker's area is below 1e-5 of it
_RIM = 2048  # points around a rim


@dataclass(frozen=True)
class Circle:
    """A disc: centre `p_C` (3,) m and unit normal `n_C` (3,) in the camera frame, `radius` m."""

    p_C: Array
    n_C: Array
    radius: float


def rim_px(camera: optics.Camera, circle: Circle, count: int = _RIM) -> Array:
    """Return the pixels (count, 2) of points around the circle's rim."""
    n = circle.n_C / np.linalg.norm(circle.n_C)
    first = np.cross(n, [0.0, 1.0, 0.0] if abs(n[1]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    t = 2 * np.pi * np.arange(count)[:, None] / count
    return optics.project(
        camera, circle.p_C + circle.radius * (np.cos(t) * first + np.sin(t) * np.cross(n, first))
    )


def coverage(camera: optics.Camera, circles: Sequence[Circle], blur_px: float) -> Array:
    """Return the fraction (H, W) of each pixel that the circles cover.

    The fraction is blurred by a Gaussian with standard deviation `blur_px`.
    """
    total = np.zeros((camera.height, camera.width))
    margin = int(np.ceil(5 * blur_px)) + 2
    for circle in circles:
        rim = rim_px(camera, circle)
        low = np.floor(rim.min(axis=0)).astype(int) - margin
        high = np.ceil(rim.max(axis=0)).astype(int) + margin
        fine = _fill((rim - low + 0.5) * SUPER, (high - low + 1) * SUPER)
        columns, rows = (_pixels_of_cells(count, blur_px) for count in (high - low + 1).tolist())
        patch = rows @ fine @ columns.T
        v0 = max(low[1], 0)
        v1 = min(high[1] + 1, camera.height)
        u0 = max(low[0], 0)
        u1 = min(high[0] + 1, camera.width)
        if v1 > v0 and u1 > u0:
            total[v0:v1, u0:u1] += patch[v0 - low[1] : v1 - low[1], u0 - low[0] : u1 - low[0]]
    return np.minimum(total, 1.0)


@lru_cache(64)
def _pixels_of_cells(count: int, blur_px: float) -> Array:
    """Return the matrix (count, count * SUPER) that blurs a line of fine cells and averages them
    per pixel."""
    lines = np.eye(count * SUPER)
    if blur_px > 0:
        size = round(8 * blur_px * SUPER + 1) | 1  # four sd on each side
        kernel = cv2.getGaussianKernel(size, blur_px * SUPER)
        lines = cv2.sepFilter2D(lines, -1, np.ones(1), kernel, borderType=cv2.BORDER_REPLICATE)
    return lines.reshape(count, SUPER, -1).mean(axis=1)


def _fill(polygon: Array, size: NDArray) -> Array:
    """Compute the coverage of the cells of a (size[1], size[0]) grid by a convex polygon.

    The polygon is in cell units.
    """
    width = int(size[0])
    height = int(size[1])
    top = int(polygon[:, 1].argmin())
    bottom = int(polygon[:, 1].argmax())
    rolled = np.roll(polygon, -top, axis=0)
    count = (bottom - top) % len(polygon)
    one = rolled[: count + 1]
    other = np.concatenate([rolled[count:], rolled[:1]])[::-1]
    lines = (np.arange(height * _LINES) + 0.5) / _LINES
    x = np.sort(
        [np.interp(lines, pipeline[:, 1], pipeline[:, 0]) for pipeline in (one, other)], axis=0
    )
    inside = np.flatnonzero((lines > polygon[top, 1]) & (lines < polygon[bottom, 1]))
    cells = np.arange(width)
    spans = np.zeros((len(lines), width))
    rows = spans[inside[0] : inside[-1] + 1]
    np.subtract(x[1][inside, None], cells, out=rows)
    np.clip(rows, 0, 1, out=rows)
    left = x[0][inside, None] - cells
    rows -= np.clip(left, 0, 1, out=left)
    return spans.reshape(height, _LINES, width).mean(axis=1)


def image(
    camera: optics.Camera,
    circles: Sequence[Circle],
    *,
    blur_px: float = 0.7,
    noise_dn: float = 2.0,
    dark_dn: float = 40.0,
    bright_dn: float = 180.0,
    seed: int | None = 0,
    light: Callable[[Array, Array], Array] | None = None,
) -> NDArray[np.uint8]:
    """Render an 8-bit image of dark circles on a bright ground.

    `light(u, v)` multiplies the scene. `seed` None: no noise.
    """
    scene = exact_image(
        camera, circles, blur_px=blur_px, dark_dn=dark_dn, bright_dn=bright_dn, light=light
    )
    if seed is not None:
        scene = scene + np.random.default_rng(seed).normal(0, noise_dn, scene.shape)
    return np.clip(np.rint(scene), 0, 255).astype(np.uint8)


def exact_image(
    camera: optics.Camera,
    circles: Sequence[Circle],
    *,
    blur_px: float = 0.7,
    dark_dn: float = 40.0,
    bright_dn: float = 180.0,
    light: Callable[[Array, Array], Array] | None = None,
) -> Array:
    """Render the image (H, W) before noise and rounding, in gray levels."""
    scene = bright_dn + (dark_dn - bright_dn) * coverage(camera, circles, blur_px)
    if light is not None:
        v, u = np.mgrid[: camera.height, : camera.width].astype(float)
        scene = scene * light(u, v)
    return scene


def random_circles(
    camera: optics.Camera,
    rng: np.random.Generator,
    *,
    rows: int = 4,
    columns: int = 4,
    radius: float = 0.0015,
    depth: tuple[float, float] = (0.03, 0.06),
    tilt_deg: tuple[float, float] = (0.0, 45.0),
) -> list[Circle]:
    """Sample circles on a jittered grid in the image, with random depth and tilt.

    Defaults resemble Fig. 6 of the paper.
    """
    circles = []
    cell = np.array([camera.width / columns, camera.height / rows])
    for row in range(rows):
        for column in range(columns):
            z = rng.uniform(*depth)
            free = np.maximum(cell / 2 - 1.15 * camera.fx * radius / z - 6, 0)
            uv = (
                (np.array([column, row]) + 0.5) * cell
                - 0.5
                + rng.uniform(-1, 1, 2) * np.minimum(free, 15)
            )
            tilt = np.deg2rad(rng.uniform(*tilt_deg))
            angle = rng.uniform(0, 2 * np.pi)
            ray = optics.unproject(camera, uv)
            normal = np.array(
                [np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), -np.cos(tilt)]
            )
            circles.append(Circle(ray / ray[2] * z, normal, radius))
    return circles
