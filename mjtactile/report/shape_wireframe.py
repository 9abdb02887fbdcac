"""Wireframe of a contact shape: the border of its contact, and two arcs along its surface.

In simulation, the ground truth is cut along the same arcs.
"""

from __future__ import annotations

import math

import numpy as np

from mjtactile.core.types import Array, ContactShape
from mjtactile.recording.reader import Recording
from mjtactile.report.software_renderer import SceneCamera

_ARC = 1.2  # half-angle of the arc about the nearest point of a curved shape, rad
_RADIUS = 8e-3  # half-length of the arc of a flat shape, m, and maximum for any shape
_POINTS = 17
_FLAT = 1.0  # 1/m
# Heights relative to the shape's nearest point, m; points outside belong to another object
_BELOW = 2e-3
_ABOVE = 8e-3


def lines_of(shape: ContactShape) -> list[Array]:
    """Return lines (P, 3) m in S that show a contact shape.

    They are the closed outline, at the height of the object's nearest point, and two arcs. The arcs
    run along and across its smaller curvature. The list is empty if the shape is unknown.
    """
    if shape.kind == "unknown" or not np.isfinite(shape.p_SO).all():
        return []
    lines = []
    if len(shape.outline):
        border = np.concatenate([shape.outline, shape.outline[:1]])
        lines.append(np.column_stack([border, np.full(len(border), shape.p_SO[2])]))
    curvatures = np.nan_to_num(shape.curvatures)[::-1]
    for curvature, angle in zip(curvatures, directions_of(shape), strict=True):
        offsets, rise = _arc(curvature)
        along = np.column_stack([math.cos(angle) * offsets, math.sin(angle) * offsets, rise])
        lines.append(shape.p_SO + along)
    return lines


def directions_of(shape: ContactShape) -> tuple[float, float]:
    """Return both arcs' directions, rad from x: along the smaller curvature and across."""
    angle = shape.direction if math.isfinite(shape.direction) else 0.0
    return angle, angle + math.pi / 2


def _arc(curvature: float) -> tuple[Array, Array]:
    """Return displacements along an arc and its heights above its lowest point, m."""
    if abs(curvature) < _FLAT:
        offsets = np.linspace(-_RADIUS, _RADIUS, _POINTS)
        return offsets, np.zeros(_POINTS)
    radius = 1 / curvature
    maximum = min(_ARC, _RADIUS / abs(radius)) if abs(radius) > _RADIUS else _ARC
    angle = np.linspace(-maximum, maximum, _POINTS)
    return radius * np.sin(angle), radius * (1 - np.cos(angle))


def true_lines(shape: ContactShape, view: SceneCamera, finger: int) -> Array:
    """Cut the simulated scene along the arcs: segments (n, 2, 3), m, in S, for figures."""
    if shape.kind == "unknown" or not np.isfinite(shape.p_SO).all():
        return np.zeros((0, 2, 3))
    corners_O = (view.object_triangles() - view.p_WS[finger]) @ view.R_WS[finger] - shape.p_SO
    near = (np.abs(corners_O).min(axis=1)[:, :2] < _RADIUS).all(axis=1)
    pieces = [_plane_section(corners_O[near], angle) for angle in directions_of(shape)]
    found = np.concatenate(pieces)
    center = found.mean(axis=1)
    here = (np.hypot(center[:, 0], center[:, 1]) < _RADIUS) & (found[:, :, 2] > -_BELOW).all(axis=1)
    return found[here & (found[:, :, 2] < _ABOVE).all(axis=1)] + shape.p_SO


def _plane_section(corners: Array, turn: float) -> Array:
    """Cut triangles (m, 3, 3) with the upright plane `turn` rad from x: (n, 2, 3)."""
    distance = corners @ np.array([-math.sin(turn), math.cos(turn), 0.0])
    crossed = np.flatnonzero(distance.min(axis=1) * distance.max(axis=1) < 0)
    corners = corners[crossed]
    distance = distance[crossed]
    after = np.roll(corners, -1, axis=1)
    beyond = np.roll(distance, -1, axis=1)
    meets = distance * beyond < 0
    fraction = np.where(meets, distance, 0.0) / np.where(meets, distance - beyond, 1.0)
    points = corners + fraction[:, :, None] * (after - corners)
    two = meets.sum(axis=1) == 2  # else it passes through a corner: the neighbors have the segment
    return points[two][meets[two]].reshape(-1, 2, 3)


def describe_shape(shape: ContactShape) -> str:
    """Return a short description of a contact shape."""
    if shape.kind == "unknown":
        return f"shape unknown: {shape.status}"
    if math.isfinite(shape.radius):
        return f"{shape.family}, radius {1e3 * shape.radius:.1f} mm"
    if shape.kind == "smooth":
        return f"smooth, {shape.curvatures[0]:.0f} and {shape.curvatures[1]:.0f} /m"
    return shape.family


def recorded_shape(recording: Recording, cycle: int, finger: int) -> ContactShape | None:
    """Read the logged part of a contact shape.

    Args:
        recording: The recording.
        cycle: Index of the cycle.
        finger: Index of the finger.

    Returns:
        The shape; None if there was no estimate.
    """
    columns = recording.columns
    kind = columns["shape_kind"][cycle][finger] if "shape_place" in columns else "none"
    if kind in ("none", "unknown"):
        return None
    outline = np.array(columns["shape_outline"][cycle][finger], float).reshape(-1, 2)
    values = {
        name: recording.column(f"shape_{name}")[cycle, finger]
        for name in ("radius", "direction", "area", "curvatures")
    }
    position = recording.column("shape_place")[cycle, finger]
    family = str(columns["shape_family"][cycle][finger])
    return ContactShape(kind, {kind: 1.0}, p_SO=position, outline=outline, family=family, **values)
