"""Additional indentation by a contact too small for the mesh (docs/theory/simulation_contact.md,
C6).

All lengths are in cells of the mesh (the square root of a vertex's area). Loads are forces over 2
pi times the tension and a cell.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array

MESH_RADIUS = 0.198
"""Radius at which a lattice's response to a point force equals ln(1/a): exp(-(gamma + 1.5 ln
2))."""
MAX_RADIUS = 0.5
"""Contact radius, in cells, above which adjacent vertices carry the contact jointly."""
_LINE = 0.31  # deepening of contact on a line: 1 - ln 2
# tuned to the forces on a cone and a cube's corner; a soap film has 0, the mesh's own tension gives
# 4 to 6 (L5)
_TIGHTENING = 2.0
_HALVINGS = 24
_SAME_POINT = 0.3  # cells between touches of one feature
# minimum distance of two discs at one position, relative to the sum of their radii: exp(-1/4) / 2
_MUTUAL = 0.39
_TINY = 1e-12


def profile(near: Array, far: Array, radii: tuple[float, float]) -> tuple[Array, Array]:
    """Return slopes and curvatures, not negative, of a shape that rises by `near` and `far` at
    distances `radii` along each line. rise = slope r + curvature r^2/4. The curvature is the sum of
    a sphere's two principal curvatures."""
    first, last = radii
    curvature = 4 * (far / last - near / first) / (last - first)
    slope = near / first - curvature * first / 4
    curvature = np.where(slope < 0, 4 * far / last**2, np.where(curvature < 0, 0.0, curvature))
    return np.where(slope < 0, 0.0, np.where(curvature > 0, slope, far / last)), curvature


def contact_radius(load: Array, slope: Array, curvature: Array) -> Array:
    """Return the radius a at which a membrane leaves a shape: load = a sin(angle of the shape at
    a)."""
    low = np.zeros(np.broadcast(load, slope).shape)
    high = np.full(np.broadcast(load, slope).shape, MAX_RADIUS)
    for _ in range(_HALVINGS):
        midpoint = (low + high) / 2
        steep = slope + curvature * midpoint / 2
        small = midpoint * steep / np.sqrt(1 + steep * steep) < load
        low = np.where(small, midpoint, low)
        high = np.where(small, high, midpoint)
    return high


def depth_beyond_mesh(
    load: Array, slope: Array, curvature: Array, width: float = 0.0
) -> tuple[Array, Array]:
    """Return the additional indentation (k,) under each `load` (k,), and the contact radii (k,).

    `slope` and `curvature` (k, d) describe the shape in d directions over half a turn. `width` is
    the half-width of a flat edge, on whose rim the membrane hangs.
    """
    radii = contact_radius(load[:, None], slope, curvature)
    on_rim = radii.max(axis=1) < width
    radii = np.maximum(radii, width)
    longest = radii.max(axis=1)
    shortest = radii.min(axis=1)
    radius = (longest + shortest) / 2  # equivalent radius of an ellipse's potential
    steep = slope.mean(axis=1)
    bent = curvature.mean(axis=1)
    compact = _deepening(steep + bent * radius / 4, steep + bent * radius / 2)
    compact = np.where(on_rim, 0.0, compact)
    deepening = _LINE + (compact - _LINE) * shortest / longest
    return load * (np.log(MESH_RADIUS / radius) + deepening), radius


def depth_under_end(load: Array, width: float, vertices: Array) -> Array:
    """Return the additional indentation (k,) under a flat round end of radius `width`.

    `load` (k,) acts on each of the touching vertices (k, 2). An end wider than the mesh's effective
    point indents less.
    """
    distance = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    np.fill_diagonal(distance, MESH_RADIUS)
    return np.log(distance / width) @ load


def _deepening(mean: Array, steep: Array) -> Array:
    """Return the indentation of a round contact beyond ln(mesh/a): 1/2 for a shallow ball, 1 for a
    cone.

    The shape falls from the contact's rim to its tip with the mean slope `mean`, and the membrane
    leaves it with the slope `steep`. Tangents of the membrane's angle are integrated outward from
    the rim. The load there is tension times radius times the sine of the angle.
    """
    k = _TIGHTENING
    c = 1 / np.sqrt(1 + steep * steep)
    s = np.maximum(steep * c, _TINY)
    tight = (-np.log(c) - (k - 1) ** 2 / (2 * k - 1) * np.log(k + (1 - k) * c)) / k - k / (
        2 * k - 1
    ) * np.log(2 / (1 + c))
    return 1 + np.log(2 / (1 + c)) + tight - (steep - mean) / ((1 + k * (1 / c - 1)) * s)


def depth_of_neighbours(load: Array, radius: Array, vertices: Array, touches: Array) -> Array:
    """Return the additional indentation (k,) at each vertex due to the loads of the others.

    Several `vertices` (k, 2) may bear on one location, at `touches` (k, 2).
    """
    distance, close = (np.linalg.norm(p[:, None] - p, axis=-1) for p in (vertices, touches))
    same_point = (close < _SAME_POINT) & ~np.eye(len(load), dtype=bool)
    close = np.maximum(close, _MUTUAL * (radius[:, None] + radius))
    return np.log(np.where(same_point, distance / close, 1.0)) @ load
