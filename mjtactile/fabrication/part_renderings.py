"""Images of the parts, exploded or cut open: triangles without OpenGL, labels by matplotlib."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.fabrication.layered_solid import Part
from mjtactile.fabrication.mesh import triangles_of
from mjtactile.kernels import kernel
from mjtactile.report.figures import new_figure

_LIGHT = np.array([-0.35, 0.60, 0.72])  # right, up, towards the viewer
_AMBIENT = 0.5
_SAMPLES = 2
_LINE = 0.15  # grey of a line
_BORDER = 1.06
_GAP = 0.16  # between parts, as a fraction of their width
_BOLT = 0.35  # fraction of a bolt's length that stays in its hole
_OUTLINE = 0.012  # depth jump rendered as a line, as a fraction of the image's half width
FRONT = (0.62, 0.42, 0.66), (0.0, 1.0, 0.0)
SIDE = (0.22, -0.93, 0.30), (1.0, 0.0, 0.0)
"""Directions in S towards the viewer, and up: front with +x side; and a section's view."""
View = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class RenderedSolid:
    """Solid in an image: `shift` mm along z, and its label ("": none)."""

    part: Part
    solid: Any
    shift: float = 0.0
    label: str = ""


def view_axes(view: View) -> Array:
    """Return the image axes as rows: right, up and towards the viewer."""
    towards, up = (np.array(direction) / np.linalg.norm(direction) for direction in view)
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


def render(
    items: Sequence[RenderedSolid], *, view: View = FRONT, pixels: int = 800, cut: bool = False
) -> tuple[Array, list[Array | None]]:
    """Render an image (h, w, 3) with values from 0 to 1; `cut` removes the half y < 0.

    Also return an image point inside each solid, px (right, down), None for a hidden one.
    """
    axes = view_axes(view)
    corners = []
    for item in items:
        solid = item.solid.trim_by_plane((0.0, 1.0, 0.0), 0.0) if cut else item.solid
        corners.append((triangles_of(solid) + (0, 0, item.shift)) @ axes.T)
    every = np.concatenate(corners)
    low = every.reshape(-1, 3).min(axis=0)
    high = every.reshape(-1, 3).max(axis=0)
    every = (every - (low + high) / 2) / (_BORDER * (high - low)[0] / 2)
    rows = max(round(pixels * (high - low)[1] / (high - low)[0]), 60)
    size = rows * _SAMPLES, pixels * _SAMPLES
    owner_of = np.repeat(np.arange(len(items)), [len(triangles) for triangles in corners])
    colours = _shaded(every, np.array([item.part.colour for item in items])[owner_of])
    nearest, depth = _paint(every, size)
    image = np.vstack([colours, np.ones((1, 3))])[nearest]
    image[_depth_edges(depth)] = _LINE
    owners = np.append(owner_of, -1)[nearest]
    anchors = [_anchor(owners == index) for index in range(len(items))]
    return image.reshape(rows, _SAMPLES, pixels, _SAMPLES, 3).mean(axis=(1, 3)), anchors


def _shaded(corners: Array, rgb: Array) -> Array:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    brightness = _AMBIENT + (1 - _AMBIENT) * np.clip(normals @ _LIGHT, 0, 1)
    return np.clip(rgb * brightness[:, None], 0, 1)


def _paint(corners: Array, size: tuple[int, int]) -> tuple[NDArray[np.int64], Array]:
    """Return the index (-1: none) and depth (-inf) of the nearest triangle at each pixel."""
    owner_of = np.repeat(np.arange(len(corners), dtype=float)[:, None], 3, axis=1)
    nearest = np.full((*size, 3), -1.0)
    depth = np.full(size, -np.inf)
    corners = np.ascontiguousarray(corners)
    kernel("paint_triangles")(len(corners), corners, owner_of, *size, depth, nearest)
    return nearest[..., 0].astype(np.int64), depth


def _depth_edges(depth: Array) -> Array:
    """Return a mask (h, w) of depth jumps: silhouettes of parts in front of others."""
    near = np.where(np.isfinite(depth), depth, -10.0)
    found = np.zeros(depth.shape, bool)
    found[1:-1, :] |= np.abs(np.diff(near, 2, axis=0)) > _OUTLINE
    found[:, 1:-1] |= np.abs(np.diff(near, 2, axis=1)) > _OUTLINE
    return found


def _anchor(visible: Array) -> Array | None:
    """Return a pixel (right, down) well inside a solid's visible area; None if it is hidden."""
    if not visible.any():
        return None
    distance = cv2.distanceTransform(np.pad(visible, 1).astype(np.uint8), cv2.DIST_L2, 3)[
        1:-1, 1:-1
    ]
    return np.array(np.unravel_index(int(np.argmax(distance)), visible.shape)[::-1]) / _SAMPLES


def save_png(items: Sequence[RenderedSolid], name: str, **view: Any) -> bytes | None:
    """Return the labeled image as PNG; None, with a message on stderr, without matplotlib."""
    image, anchors = render(items, **view)
    rows, columns = image.shape[:2]
    margin = 60
    figure = new_figure(name, (columns / 100, (rows + 2 * margin) / 100), dpi=100)
    if figure is None:
        return None
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(image, interpolation="nearest")
    axes.set(xlim=(0, columns), ylim=(rows + margin, -margin))
    axes.set_axis_off()
    pairs = zip(items, anchors, strict=True)
    labels = [(anchor, item.label) for item, anchor in pairs if anchor is not None and item.label]
    _label(axes, labels, rows, columns, margin)
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _label(
    axes: Any, labels: list[tuple[Array, str]], rows: int, columns: int, margin: int
) -> None:
    """Write the names of the upper half above the image, the others below, from left to right."""
    order = sorted(labels, key=lambda label: label[0][1])
    half = (len(order) + 1) // 2
    gray = "#444444"
    text = {"fontsize": 10, "ha": "center", "va": "center"}
    arrow = {"arrowstyle": "-", "color": gray, "lw": 0.8, "shrinkA": 1, "shrinkB": 0}
    for group, y in ((order[:half], 18 - margin), (order[half:], rows + margin - 18)):
        for k, (anchor, name) in enumerate(sorted(group, key=lambda label: label[0][0])):
            x = columns * (k + 0.5) / len(group)
            axes.annotate(name, anchor, (x, y), arrowprops=arrow, **text)
            axes.plot(*anchor, "o", ms=3.5, color=gray)


def explode(parts: Mapping[str, Part], order: Sequence[str]) -> dict[str, float]:
    """Return the shifts along z, mm, that place the parts of `order` one behind the other.

    Bolts stay in the following ring by a third. Nuts are behind the flange of the mount.
    """
    gap = _GAP * max(parts[name].size[0] for name in order)
    shifts: dict[str, float] = {}
    edge = 0.0  # the back side of the last part
    for before, name in zip((None, *order), order, strict=False):
        part = parts[name]
        if name == "nuts" and before is not None:
            shifts[name] = shifts[before] - gap / 2
            continue
        shifts[name] = edge - part.high
        edge = part.low + shifts[name] - gap
        if name == "bolts":
            edge += gap + _BOLT * part.size[2]
    return shifts


def bodies_of(
    parts: Mapping[str, Part], solids: Mapping[str, Any], shifts: Mapping[str, float]
) -> list[RenderedSolid]:
    """Return the solids of an image: those in `shifts`, by name."""
    return [
        RenderedSolid(parts[name], solids[name], shift, name.replace("_", " "))
        for name, shift in shifts.items()
    ]
