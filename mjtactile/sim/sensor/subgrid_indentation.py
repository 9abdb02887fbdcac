"""How much deeper a small contact pushes a sheet than the sheet's mesh can show
(docs/theory/simulation_contact.md, C6). Pure functions.

All lengths are in cells of the mesh (the root of the area that a vertex stands for), loads are
forces over 2 pi times the tension and a cell.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array

MESH_RADIUS = 0.198
"""Of the point at which a five-point lattice's response to a force equals ln(1/a): exp(-(gamma +
1.5 ln 2)), gamma Euler's."""
WIDEST = 0.5
"""Radius of contact from which neighbours share it."""
_LINE = 0.31  # deepening of contact on a line: 1 - ln 2
# chosen by the forces on a cone and a cube's corner: 0 of a soap film, 4 to 6 by the mesh's own
# tension (L5)
_TIGHTENING = 2.0
_HALVINGS = 24
_ONE_PLACE = 0.3  # cells between touches of one feature
_MUTUAL = 0.39  # of two discs at one place: exp(-1/4) / 2 of the sum of their radii
_LEAST = 1e-12


def profile(near: Array, far: Array, radii: tuple[float, float]) -> tuple[Array, Array]:
    """Slopes and curvatures, not negative, of the shape that rises by `near` and `far` at distances
    `radii` along each line: rise = slope r + curvature r^2/4, the curvature being the sum of a
    ball's two."""
    first, last = radii
    curvature = 4 * (far / last - near / first) / (last - first)
    slope = near / first - curvature * first / 4
    curvature = np.where(slope < 0, 4 * far / last**2, np.where(curvature < 0, 0.0, curvature))
    return np.where(slope < 0, 0.0, np.where(curvature > 0, slope, far / last)), curvature


def contact_radius(load: Array, slope: Array, curvature: Array) -> Array:
    """Radius a at which a sheet leaves a shape under `load`: load = a sin(angle of the shape at a),
    at most `WIDEST`."""
    low = np.zeros(np.broadcast(load, slope).shape)
    high = np.full(np.broadcast(load, slope).shape, WIDEST)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        steep = slope + curvature * middle / 2
        small = middle * steep / np.sqrt(1 + steep * steep) < load
        low = np.where(small, middle, low)
        high = np.where(small, high, middle)
    return high


def depth_beyond_mesh(
    load: Array, slope: Array, curvature: Array, width: float = 0.0
) -> tuple[Array, Array]:
    """How much deeper (k,) a sheet is under each `load` (k,) than its mesh, and the radii (k,) of
    contact.

    `slope` and `curvature` (k, d) are the shape's in d directions around the contact, evenly spread
    over half a turn; `width` is half of that of a flat edge, on whose rim the sheet hangs.
    """
    radii = contact_radius(load[:, None], slope, curvature)
    on_rim = radii.max(axis=1) < width
    radii = np.maximum(radii, width)
    longest = radii.max(axis=1)
    shortest = radii.min(axis=1)
    radius = (longest + shortest) / 2  # an ellipse's, as its potential sees it
    steep = slope.mean(axis=1)
    bent = curvature.mean(axis=1)
    compact = _deepening(steep + bent * radius / 4, steep + bent * radius / 2)
    compact = np.where(on_rim, 0.0, compact)
    deepening = _LINE + (compact - _LINE) * shortest / longest
    return load * (np.log(MESH_RADIUS / radius) + deepening), radius


def depth_under_end(load: Array, width: float, vertices: Array) -> Array:
    """How much deeper (k,) a sheet is than its mesh under a flat round end of radius `width`, on
    whose rim it hangs, by the `load` (k,) on each of the vertices (k, 2) that bear on it. Below 0:
    an end that is wider than the mesh's point goes less deep."""
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    np.fill_diagonal(apart, MESH_RADIUS)
    return np.log(apart / width) @ load


def _deepening(mean: Array, steep: Array) -> Array:
    """Beyond ln(mesh/a), of a round contact from whose rim the shape falls to its tip with the
    slope `mean`, and that the sheet leaves with the slope `steep`: 1/2 of a shallow ball, 1 of a
    shallow cone.

    Tangents of the sheet's angle, integrated outward from the rim where tension times the sine of
    the angle times the radius is the load, and the tension is 1 + k (1/cos - 1).
    """
    k = _TIGHTENING
    c = 1 / np.sqrt(1 + steep * steep)
    s = np.maximum(steep * c, _LEAST)
    tight = (-np.log(c) - (k - 1) ** 2 / (2 * k - 1) * np.log(k + (1 - k) * c)) / k - k / (
        2 * k - 1
    ) * np.log(2 / (1 + c))
    return 1 + np.log(2 / (1 + c)) + tight - (steep - mean) / ((1 + k * (1 / c - 1)) * s)


def depth_of_neighbours(load: Array, radius: Array, vertices: Array, touches: Array) -> Array:
    """The same (k,) for what the other vertices' loads do at each, where several vertices at
    `vertices` (k, 2) bear on one place: they touch at `touches` (k, 2), closer to each other than
    the mesh has them."""
    apart, close = (np.linalg.norm(p[:, None] - p, axis=-1) for p in (vertices, touches))
    one_place = (close < _ONE_PLACE) & ~np.eye(len(load), dtype=bool)
    close = np.maximum(close, _MUTUAL * (radius[:, None] + radius))
    return np.log(np.where(one_place, apart / close, 1.0)) @ load
