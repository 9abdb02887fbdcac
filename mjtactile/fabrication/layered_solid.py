"""Solids as stacks of plates, mm, in frame S: z outward, flat membrane at z = 0.

Each layer is bounded by rounded rectangles, circles and convex polygons. They may be nested but
never cross. This is sufficient for a milled, printed or laser-cut housing, and it keeps the exact
shape: `step_file` writes its planes and cylinders, `mesh` its triangles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np
from scipy.spatial import ConvexHull

from mjtactile.core.outline import Outline
from mjtactile.core.types import Array

_GAP = 1e-3  # mm
_STRAIGHT = 5e-3  # deviation of an outline's harmonics from a straight side, mm
_CORNERS = 240  # points of a polygon for an outline: deviates by 1 um from a circle of 30 mm


@dataclass(frozen=True)
class Contour:
    """Rectangle about (x, y) with half sizes `hx`, `hy` and corner radius `r`.

    It is a circle if r = hx = hy.
    """

    hx: float
    hy: float
    r: float = 0.0
    x: float = 0.0
    y: float = 0.0

    @property
    def area(self) -> float:
        return 4 * self.hx * self.hy - (4 - math.pi) * self.r**2

    @property
    def corner(self) -> tuple[float, float]:
        """The corner of its box with the lowest x and y."""
        return self.x - self.hx, self.y - self.hy

    @property
    def east(self) -> tuple[float, float]:
        """Its farthest point along x."""
        return self.x + self.hx, self.y

    @property
    def is_circle(self) -> bool:
        return self.r == self.hx == self.hy

    def distance(self, x: float, y: float) -> float:
        """Return the signed distance of a point, mm: negative inside."""
        qx = abs(x - self.x) - self.hx + self.r
        qy = abs(y - self.y) - self.hy + self.r
        return math.hypot(max(qx, 0.0), max(qy, 0.0)) + min(max(qx, qy), 0.0) - self.r

    def edges(self) -> list[tuple[Array, Array, Array | None]]:
        """Return start (2,), end (2,) and center (2,; None if straight), counter-clockwise."""
        center = np.array([self.x, self.y])
        if self.is_circle:
            east = center + (self.r, 0.0)
            west = center - (self.r, 0.0)
            return [(east, west, center), (west, east, center)]
        edges: list[tuple[Array, Array, Array | None]] = []
        signs = [(1, -1), (1, 1), (-1, 1), (-1, -1)]  # corners, from below right
        radii = self.r * np.array([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
        centres = [center + (sx * (self.hx - self.r), sy * (self.hy - self.r)) for sx, sy in signs]
        for k, centre in enumerate(centres):
            end = centre + radii[k + 1]
            if self.r:
                edges.append((centre + radii[k], end, centre))
            edges.append((end, centres[(k + 1) % 4] + radii[k + 1], None))
        return edges

    def polygon(self, per_quarter: int) -> Array:
        """Return points (n, 2), counter-clockwise; `per_quarter` chords replace a quarter
        circle."""
        points = []
        for start, _end, centre in self.edges():
            points.append(start)
            if centre is None:
                continue
            first = math.atan2(*(start - centre)[::-1])
            steps = per_quarter * (2 if self.is_circle else 1)
            angles = first + 0.5 * math.pi / per_quarter * np.arange(1, steps)
            points.extend(centre + self.r * np.column_stack([np.cos(angles), np.sin(angles)]))
        return np.array(points)


@dataclass(frozen=True)
class Traced(Contour):
    """Convex polygon with corners `points`, counter-clockwise; `x`, `y`, `hx`, `hy`: its box."""

    points: tuple[tuple[float, float], ...] = ()

    @classmethod
    def around(cls, outline: Outline, by: float = 0.0, flat: float = 0.0) -> Traced:
        """Return the polygon `by` mm outside of an outline (m).

        Its +x side is straight for a bore, over `flat` mm on both sides of the axis.
        """
        at = 1e3 * outline.points(_CORNERS)
        along = np.roll(at, -1, axis=0) - np.roll(at, 1, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        at = at + by * np.column_stack([along[:, 1], -along[:, 0]])
        if flat:
            end = at[:, 0].max()
            on_side = at[:, 0] > end - _STRAIGHT
            y = [*at[on_side, 1], -flat, flat]
            at = np.concatenate([at[~on_side], [(end, min(y)), (end, max(y))]])
        at = at[ConvexHull(at).vertices]  # counter-clockwise
        low, high = at.min(axis=0), at.max(axis=0)
        midpoint = (low + high) / 2
        half = (high - low) / 2
        points = tuple((float(x), float(y)) for x, y in at)
        return cls(*map(float, half), x=float(midpoint[0]), y=float(midpoint[1]), points=points)

    @property
    def area(self) -> float:
        x, y = np.array(self.points).T
        return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2

    @property
    def east(self) -> tuple[float, float]:
        """Farthest point along x; the midpoint if that side is straight."""
        at = np.array(self.points)
        x = at[:, 0].max()
        return float(x), float(at[at[:, 0] == x, 1].mean())

    @property
    def is_circle(self) -> bool:
        return False

    def distance(self, x: float, y: float) -> float:
        """Return the signed distance of a point, mm: negative inside.

        Outside, beyond a corner, it is less than the distance.
        """
        at = np.array(self.points)
        along = np.roll(at, -1, axis=0) - at
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        offset = np.array([x, y]) - at
        return float((offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]).max())

    def edges(self) -> list[tuple[Array, Array, Array | None]]:
        """Return the edges in the format of a rectangle, all straight."""
        at = np.array(self.points)
        return [(a, b, None) for a, b in zip(at, np.roll(at, -1, axis=0), strict=True)]

    def polygon(self, per_quarter: int) -> Array:
        """Return the corners (n, 2)."""
        return np.array(self.points)


def circle(radius: float, x: float = 0.0, y: float = 0.0) -> Contour:
    """Return a circle of `radius`, mm, about (x, y)."""
    return Contour(radius, radius, radius, x, y)


@dataclass(frozen=True)
class Region:
    """Area inside `outer` and outside of all `holes`."""

    outer: Contour
    holes: tuple[Contour, ...] = ()

    @property
    def area(self) -> float:
        return self.outer.area - sum(hole.area for hole in self.holes)

    def holds(self, x: float, y: float) -> bool:
        return self.outer.distance(x, y) < 0 and all(hole.distance(x, y) > 0 for hole in self.holes)


@dataclass(frozen=True)
class Layer:
    """Plates between the heights `low` and `high`."""

    low: float
    high: float
    regions: tuple[Region, ...]

    @property
    def volume(self) -> float:
        return (self.high - self.low) * sum(region.area for region in self.regions)

    def holds(self, x: float, y: float) -> bool:
        return any(region.holds(x, y) for region in self.regions)


@dataclass(frozen=True)
class Bore:
    """Hole of `radius` along x at (y, z), from the +x side of `inner` to that of `outer`."""

    inner: Contour
    outer: Contour
    radius: float
    y: float
    z: float

    @property
    def ends(self) -> tuple[float, float]:
        return self.inner.x + self.inner.hx, self.outer.x + self.outer.hx

    @property
    def volume(self) -> float:
        start, end = self.ends
        return math.pi * self.radius**2 * (end - start)


@dataclass(frozen=True)
class Part:
    """Solid: contiguous `layers` from back to front, and a `bore`; `make`: it has CAD files."""

    name: str
    layers: tuple[Layer, ...]
    colour: tuple[float, float, float] = (0.6, 0.62, 0.66)
    bore: Bore | None = None
    make: bool = True
    description: str = field(default="", compare=False)

    @property
    def volume(self) -> float:
        """Closed form, mm^3."""
        return sum(layer.volume for layer in self.layers) - (self.bore.volume if self.bore else 0.0)

    @property
    def low(self) -> float:
        return self.layers[0].low

    @property
    def high(self) -> float:
        return self.layers[-1].high

    @property
    def size(self) -> tuple[float, float, float]:
        """Extent along x, y and z, mm."""
        outers = [region.outer for layer in self.layers for region in layer.regions]
        x = max(o.x + o.hx for o in outers) - min(o.x - o.hx for o in outers)
        y = max(o.y + o.hy for o in outers) - min(o.y - o.hy for o in outers)
        return x, y, self.high - self.low


def crossing(part: Part) -> tuple[Contour, Contour] | None:
    """Return two contours of the same or neighboring layers that cross or touch."""
    contours = [
        [c for region in layer.regions for c in (region.outer, *region.holes)]
        for layer in part.layers
    ]
    for here, there in pairwise([*contours, []]):
        for first, other in combinations(dict.fromkeys([*here, *there]), 2):
            if not _may_touch(first, other):
                continue
            of_one = [other.distance(x, y) for x, y in first.polygon(8)]
            of_other = [first.distance(x, y) for x, y in other.polygon(8)]
            is_separate = min(of_one) > _GAP and min(of_other) > _GAP
            if not (is_separate or max(of_one) < -_GAP or max(of_other) < -_GAP):
                return first, other
    return None


def _may_touch(contour: Contour, other: Contour) -> bool:
    return (
        abs(contour.x - other.x) < contour.hx + other.hx + _GAP
        and abs(contour.y - other.y) < contour.hy + other.hy + _GAP
    )


def plate(low: float, high: float, outer: Contour, holes: Sequence[Contour] = ()) -> Layer:
    """Return one plate."""
    return Layer(low, high, (Region(outer, tuple(holes)),))
