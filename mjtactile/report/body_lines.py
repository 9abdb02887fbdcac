"""A felt body as lines to draw: the border of its contact, and the body itself in two arcs."""

from __future__ import annotations

import math

import numpy as np

from mjtactile.core.types import Array, FeltShape

_ARC = 1.2  # rad to either side of the nearest point, of a bent body
_REACH = 8e-3  # m, of a flat one, and at most of any
_POINTS = 17
_FLAT = 1.0  # 1/m


def lines_of(shape: FeltShape) -> list[Array]:
    """Lines (P, 3) m in S: the outline, at the height of the body's nearest point, closed; an arc
    along its smaller curvature and one across. None where the shape is unknown."""
    if shape.kind == "unknown" or not np.isfinite(shape.p_SO).all():
        return []
    lines = []
    if len(shape.outline):
        border = np.concatenate([shape.outline, shape.outline[:1]])
        lines.append(np.column_stack([border, np.full(len(border), shape.p_SO[2])]))
    most, least = (value if math.isfinite(value) else 0.0 for value in shape.curvatures)
    angle = shape.direction if math.isfinite(shape.direction) else 0.0
    for curvature, turn in ((least, angle), (most, angle + math.pi / 2)):
        way, rise = _arc(curvature)
        along = np.column_stack([math.cos(turn) * way, math.sin(turn) * way, rise])
        lines.append(shape.p_SO + along)
    return lines


def _arc(curvature: float) -> tuple[Array, Array]:
    """Ways along and rises of a circle about its lowest point, m."""
    if abs(curvature) < _FLAT:
        way = np.linspace(-_REACH, _REACH, _POINTS)
        return way, np.zeros(_POINTS)
    radius = 1 / curvature
    most = min(_ARC, _REACH / abs(radius)) if abs(radius) > _REACH else _ARC
    turn = np.linspace(-most, most, _POINTS)
    return radius * np.sin(turn), radius * (1 - np.cos(turn))


def words_of(shape: FeltShape) -> str:
    """What it is, in a few words; "" where nobody asked, or nothing is known."""
    if shape.kind == "unknown":
        return f"shape unknown: {shape.status}"
    if math.isfinite(shape.radius):
        return f"{shape.family}, radius {1e3 * shape.radius:.1f} mm"
    if shape.kind == "smooth":
        return f"smooth, {shape.curvatures[0]:.0f} and {shape.curvatures[1]:.0f} /m"
    return shape.family
