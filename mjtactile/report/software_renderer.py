"""Rendering of a simulated scene without OpenGL.

The view is from far away. Each pixel shows the nearest triangle, shaded by one light.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from mjtactile.core.types import Array, Touch
from mjtactile.kernels import kernel

# from above, and to the side of the line that joins two fingers
_ELEVATION = np.radians(16.0)
_TURN = np.radians(24.0)
_LIGHT = np.array([-0.35, 0.55, 0.76])  # to the light: right, up, towards the viewer
_AMBIENT = 0.42
_BACKGROUND = np.array([0.97, 0.975, 0.985])
_HEIGHT = 1.5  # image height over image width
# Image width, px; samples along a side of a pixel
_PIXELS = 320
_SAMPLES = 2
# Half of the image width: minimum, m, and multiple of the sensors' distance from their center
_HALF_WIDTH_MIN = 0.07
_AROUND = 2.4
_PER_NEWTON = 0.75  # arrow length per newton, in halves of the image width


class SceneCamera(Protocol):
    """Interface of `mjtactile.sim.scenes.scene_triangles.SceneView`."""

    @property
    def p_WS(self) -> Array: ...
    @property
    def R_WS(self) -> Array: ...
    def object_triangles(self) -> Array: ...
    def triangles(self) -> tuple[Array, Array]: ...


def render_scene(
    axes: Any, view: SceneCamera, touch: Sequence[Touch], colours: Sequence[str]
) -> None:
    """Render the sensors' surroundings, with an arrow of each finger's estimated force."""
    center, half, axes_PW = _framing(view)
    image = render_view(view, (round(_HEIGHT * _PIXELS), _PIXELS))
    axes.imshow(image, extent=(-1, 1, -_HEIGHT, _HEIGHT), interpolation="bilinear")
    for estimated, p_WS, R_WS, colour in zip(touch, view.p_WS, view.R_WS, colours, strict=False):
        if (
            estimated.touching
            and estimated.traction is not None
            and np.isfinite(estimated.traction.wrench[:3]).all()
        ):
            push_W = R_WS @ -estimated.traction.wrench[:3]  # on the object
            tip = (axes_PW @ (p_WS - center) / half)[:2]
            along = _PER_NEWTON * (axes_PW @ push_W)[:2]
            _arrow(axes, tip - along, tip, colour, f"{np.linalg.norm(push_W):.2f} N")
    bar = 1e-3 * max((mm for mm in (5, 10, 20, 50, 100, 200) if 1e-3 * mm < 0.6 * half), default=5)
    axes.plot(
        [-0.94, -0.94 + bar / half],
        [0.06 - _HEIGHT] * 2,
        color="#222222",
        linewidth=2.5,
        solid_capstyle="butt",
    )
    axes.text(-0.94, 0.09 - _HEIGHT, f"{1e3 * bar:g} mm", fontsize=9, color="#222222", va="bottom")
    axes.set(xlim=(-1, 1), ylim=(-_HEIGHT, _HEIGHT), aspect="equal")
    axes.set_axis_off()


def render_view(view: SceneCamera, size: tuple[int, int], samples: int = _SAMPLES) -> Array:
    """Render the scene, (*size, 3) from 0 to 1; `samples` per pixel side smooth edges."""
    center, half, axes_PW = _framing(view)
    corners, rgba = view.triangles()
    rows, columns = size
    image = rasterise(
        (corners - center) @ axes_PW.T / half, rgba[:, :3], (rows * samples, columns * samples)
    )
    return image.reshape(rows, samples, columns, samples, 3).mean(axis=(1, 3))


def _framing(view: SceneCamera) -> tuple[Array, float, Array]:
    """Return the image center (3,) in W, m, half of the image width, m, and the image axes."""
    center = view.p_WS.mean(axis=0)
    half = max(_HALF_WIDTH_MIN, _AROUND * float(np.linalg.norm(view.p_WS - center, axis=1).max()))
    return center, half, image_axes(view.p_WS)


def _arrow(axes: Any, start: Array, tip: Array, colour: str, text: str) -> None:
    axes.annotate(
        "",
        tip,
        start,
        arrowprops={
            "arrowstyle": "-|>,head_width=0.35,head_length=0.7",
            "color": colour,
            "lw": 3,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )
    axes.text(
        *(start + tip) / 2 + (0, 0.05),
        text,
        color=colour,
        fontsize=11,
        fontweight="bold",
        ha="center",
        va="bottom",
        bbox={
            "boxstyle": "round,pad=0.15",
            "facecolor": "white",
            "edgecolor": "none",
            "alpha": 0.8,
        },
    )


def image_axes(p_WS: Array) -> Array:
    """Return the image's axes in W as rows: right, up, and towards the viewer.

    Two sensors appear side by side. With more, the last is behind the center, visible between the
    others.
    """
    across = p_WS[-1] - p_WS[0] if len(p_WS) == 2 else p_WS.mean(axis=0) - p_WS[-1]
    angle = _TURN if len(p_WS) == 2 else np.pi / 2
    yaw = (np.arctan2(across[1], across[0]) if np.hypot(*across[:2]) > 1e-6 else 0.0) + angle
    right = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    front = np.array([np.sin(yaw), -np.cos(yaw), 0.0])  # horizontal, towards the viewer
    towards = np.cos(_ELEVATION) * front + np.sin(_ELEVATION) * np.array([0.0, 0.0, 1.0])
    return np.array([right, np.cross(towards, right), towards])


def rasterise(corners: Array, rgb: Array, size: tuple[int, int]) -> Array:
    """Render triangles (n, 3, 3): right, up, towards the viewer; the width is -1 to 1."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    # both sides are visible
    normals = np.where(normals[:, 2:] < 0, -normals, normals) / np.maximum(lengths, 1e-12)
    shade = _AMBIENT + (1 - _AMBIENT) * np.clip(normals @ _LIGHT, 0, 1)
    colours = np.clip(rgb * shade[:, None], 0, 1)
    image = np.tile(_BACKGROUND, (*size, 1))
    depth = np.full(size, -np.inf)
    kernel("paint_triangles")(len(corners), corners, colours, *size, depth, image)
    return image
