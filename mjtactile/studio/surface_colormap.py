"""Colors of the estimated membrane's indentation or traction, for an image and for triangles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Touch
from mjtactile.studio.snapshot import FingerSnapshot

KINDS = ("indentation", "traction")
_SCALE_MIN = {"indentation": 1e-3, "traction": 1e3}  # minimum upper limit of the scale, m and Pa
_UNITS = {"indentation": (1e3, "mm"), "traction": (1e-3, "kPa")}
_MAP = cv2.COLORMAP_VIRIDIS
_WHITE = (255, 255, 255)
_RED = (235, 60, 50)
_INK = (30, 30, 30)
_GRID = (13, 11)  # nodes of the surface in the scene along x and y: 240 triangles
_PER_NEWTON = 90.0  # length of the image's shear arrow, px/N


@dataclass(frozen=True, eq=False)
class Field:
    """Values at nodes (ny, nx) of a membrane, of a `kind` in KINDS; `x`, `y` in m in S."""

    kind: str
    x: Array
    y: Array
    values: Array


def field_of(estimated: FingerSnapshot, kind: str) -> Field | None:
    """Return the field of this kind; None without a rest shape, a surface or a traction."""
    touch = estimated.touch
    rest = estimated.rest
    if kind == "indentation":
        if touch.surface is None or rest is None or rest.z.shape != touch.surface.z.shape:
            return None
        return Field(kind, rest.x, rest.y, rest.z - touch.surface.z)
    if touch.traction is None:
        return None
    t = touch.traction
    return Field(kind, t.x, t.y, -t.force[:, :, 2] / np.outer(_widths(t.y), _widths(t.x)))


def _widths(x: Array) -> Array:
    """Return the width of each node's cell, m."""
    return np.convolve(np.diff(x), [0.5, 0.5]) if len(x) > 1 else np.ones(1)


def scale_of(fields: Sequence[Field | None]) -> float:
    """Return the upper limit of the color scale, common to all fingers for comparison."""
    known = [
        float(np.nanmax(f.values)) for f in fields if f is not None and np.isfinite(f.values).any()
    ]
    return max([_SCALE_MIN[f.kind] for f in fields if f is not None] + known, default=1.0)


def scale_text(kind: str, scale: float) -> str:
    factor, unit = _UNITS[kind]
    return f"{kind}: 0 (dark) to {factor * scale:.2g} {unit} (yellow)"


def centre_of_pressure(touch: Touch) -> Array | None:
    """Return the center of the normal force (2,) m in S; None without one."""
    if touch.traction is None or not touch.touching:
        return None
    weight = np.maximum(-touch.traction.force[:, :, 2], 0.0)
    total = float(weight.sum())
    if not total > 0:
        return None
    return (
        np.array([weight.sum(axis=0) @ touch.traction.x, weight.sum(axis=1) @ touch.traction.y])
        / total
    )


def at(field: Field, x: Array, y: Array) -> Array:
    """Interpolate the field linearly at other nodes, (len(y), len(x)), float32."""
    columns = np.interp(x, field.x, np.arange(len(field.x)), left=0.0)
    rows = np.interp(y, field.y, np.arange(len(field.y)), left=0.0)
    over_x, over_y = np.meshgrid(columns.astype(np.float32), rows.astype(np.float32))
    return cv2.remap(
        np.nan_to_num(field.values).astype(np.float32), over_x, over_y, cv2.INTER_LINEAR
    )


def colours(values: Array, scale: float) -> NDArray[np.uint8]:
    """Map values, 0 to `scale`, to red, green and blue (..., 3)."""
    if not values.size:
        return np.zeros((*values.shape, 3), np.uint8)
    positive = np.maximum(values, 0.0, dtype=np.float32).reshape(-1, values.shape[-1])
    levels = cv2.convertScaleAbs(positive, alpha=255 / scale)
    return cv2.cvtColor(cv2.applyColorMap(levels, _MAP), cv2.COLOR_BGR2RGB).reshape(
        *values.shape, 3
    )


def render(
    estimated: FingerSnapshot, field: Field, scale: float, size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Return an image of the membrane in camera view (x right, y down), red, green, blue (h, w, 3).

    It shows colors, contact outlines, the center of pressure, and the shear force.
    """
    width, height = size
    x = np.linspace(field.x[0], field.x[-1], width)
    y = np.linspace(field.y[0], field.y[-1], height)
    rgb = colours(at(field, x, y), scale)

    def pixels(p: Array) -> NDArray[np.int32]:
        fraction = (p - [field.x[0], field.y[0]]) / [
            field.x[-1] - field.x[0],
            field.y[-1] - field.y[0],
        ]
        return np.round(16 * fraction * [width - 1, height - 1]).astype(np.int32)

    for patch in estimated.touch.patches:
        if len(patch.outline):
            cv2.polylines(rgb, [pixels(patch.outline)], True, _WHITE, 1, cv2.LINE_AA, shift=4)
    centre = centre_of_pressure(estimated.touch)
    if centre is not None and estimated.touch.traction is not None:
        center = pixels(centre)
        drag = np.round(center + 16 * _PER_NEWTON * estimated.touch.traction.wrench[:2]).astype(
            np.int32
        )
        cv2.circle(rgb, tuple(map(int, center)), 16 * 3, _RED, -1, cv2.LINE_AA, shift=4)
        if math.hypot(*(drag - center)) > 16 * 4:
            cv2.arrowedLine(
                rgb, tuple(map(int, center)), tuple(map(int, drag)), _RED, 2, cv2.LINE_AA, 4, 0.25
            )
    return rgb


def surface_geom(
    estimated: FingerSnapshot, field: Field, scale: float, *, minimum: float = 0.0
) -> tuple[Array, Array] | None:
    """Return triangles of the estimated surface: corners (m, 3, 3) m in S, colors (m, 3) from 0 to
    1.

    Return None without a surface. If `minimum` is not 0, only triangles above that fraction of the
    scale are included.
    """
    surface = estimated.touch.surface
    if surface is None:
        return None
    nx, ny = _GRID
    x = np.linspace(surface.x[0], surface.x[-1], nx)
    y = np.linspace(surface.y[0], surface.y[-1], ny)
    z = at(Field("", surface.x, surface.y, surface.z), x, y)
    values = at(field, x, y)
    corners = triangles(np.dstack([*np.meshgrid(x, y), z]))
    level = triangles(values[:, :, None])[:, :, 0].mean(axis=1)
    some = level > minimum * scale if minimum else np.ones(len(level), bool)
    return corners[some], colours(level[some], scale) / 255


def triangles(nodes: Array) -> Array:
    """Convert values (ny, nx, d) at grid nodes to (m, 3, d) at the corners of triangles.

    The corners are counter-clockwise viewed from +z.
    """
    a = nodes[:-1, :-1]
    b = nodes[:-1, 1:]
    c = nodes[1:, 1:]
    d = nodes[1:, :-1]
    return np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2).reshape(
        -1, 3, nodes.shape[-1]
    )


def height_at(touch: Touch, p_S: Array) -> Array:
    """Return points (k, 3) m in S on the estimated surface over `p_S` (k, 2)."""
    if touch.surface is None:
        return np.column_stack([p_S, np.zeros(len(p_S))])
    s = touch.surface
    columns = np.interp(p_S[:, 0], s.x, np.arange(len(s.x))).astype(np.float32)
    rows = np.interp(p_S[:, 1], s.y, np.arange(len(s.y))).astype(np.float32)
    z = cv2.remap(s.z.astype(np.float32), columns[:, None], rows[:, None], cv2.INTER_LINEAR)[:, 0]
    return np.column_stack([p_S, z])
