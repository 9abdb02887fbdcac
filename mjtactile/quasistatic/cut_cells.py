"""Cut cells of a membrane grid with a non-rectangular outline.

Nodes outside the outline are fixed. Cells inside are whole. A cut cell keeps a polygon of nodes and
of points where grid lines cross the outline. The polygon is divided into triangles with linear
displacements, which vanish at the crossings. A quadrilateral is divided along both diagonals, each
with weight one half. The kernel treats whole cells the same, so symmetry is preserved. The area
between the outline and its chord in a cell is neglected. It decreases with the square of the
spacing, as the error of whole cells does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.outline import Outline
from mjtactile.core.sensor_parts import Frame
from mjtactile.core.types import Array

_POINTS = 4096  # points of the outline; chords deviate by 0.005 um from a circle of 30 mm
_NEAREST = 0.01  # distance, in spacings, within which a node is fixed on the outline
_TOGETHER = 8  # triangles, as kernels/qs_cut_cells.h has them
_HEADER = 2  # length of the header, values
_NOTHING = 1e-9  # of a cell
_SAME = 1e-6  # symmetry tolerance of an outline, in spacings
_DIVISIONS = {
    3: [((0, 1, 2), 1.0)],
    4: [((0, 1, 2), 0.5), ((0, 2, 3), 0.5), ((1, 2, 3), 0.5), ((0, 1, 3), 0.5)],
}
_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))  # corners of a cell, counter-clockwise


def cut_grid(frame: Frame, x: Array, y: Array) -> tuple[Array, float]:
    """Cut a grid with lines `x` (nx,), `y` (ny,), m, with the outline of a frame.

    Return the input of kernels/qs_cut_cells.h, empty for a rectangle, and the area inside, m^2.
    """
    if frame.outline is None:
        return np.empty(0), frame.length * frame.width
    crossings = _Crossings.of(frame.outline, x, y)
    inside = crossings.inside
    free_corners = sum(
        inside[i : len(x) - 1 + i, j : len(y) - 1 + j].astype(int) for i, j in _CORNERS
    )
    uncut = np.zeros(inside.shape)
    uncut[:-1, :-1] = free_corners == 4
    padded = np.pad(inside, 1)
    shifts = [(1 + i, 1 + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    near = np.any([padded[i : len(x) + i, j : len(y) + j] for i, j in shifts], axis=0)
    cells = np.argwhere((free_corners > 0) & (free_corners < 4))
    triangles = [triangle for i, j in cells for triangle in _triangles(crossings, int(i), int(j))]
    cell = float((x[1] - x[0]) * (y[1] - y[0]))
    groups, area = _group(triangles, len(y), cell)
    nodes = np.where(inside, 1, np.where(near, 0, -1))
    header = (float(crossings.lopsided), float(len(groups)))
    kept = np.concatenate([header, nodes.ravel(), uncut.ravel(), groups.ravel()])
    return kept, area + cell * float(uncut.sum())


def free_nodes(cut: Array, grid: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the mask (nx, ny) of free nodes from the result of `cut_grid`."""
    return cut[_HEADER : _HEADER + grid[0] * grid[1]].reshape(grid) > 0


@dataclass(frozen=True, eq=False)
class _Crossings:
    """Crossings of a grid and an outline. `inside` (nx, ny) is True for free nodes.

    Grid line k along y, at x[k], crosses the outline at `across_y` (2, nx), lower and upper. Line k
    along x crosses it at `across_x` (2, ny).
    """

    x: Array
    y: Array
    inside: NDArray[np.bool_]
    across_x: Array
    across_y: Array

    @classmethod
    def of(cls, outline: Outline, x: Array, y: Array) -> _Crossings:
        points = outline.points(_POINTS)
        across_y = _boundary_crossings(points, x)
        across_x = _boundary_crossings(points[:, ::-1], y)
        near_x = _NEAREST * (x[1] - x[0])
        near_y = _NEAREST * (y[1] - y[0])
        along_y = (y > across_y[0][:, None] + near_y) & (y < across_y[1][:, None] - near_y)
        along_x = (x > across_x[0][:, None] + near_x) & (x < across_x[1][:, None] - near_x)
        return cls(x, y, along_y & along_x.T, across_x, across_y)

    @property
    def lopsided(self) -> bool:
        """True if the outline is asymmetric about x or about y."""
        spacings = (self.y[1] - self.y[0], self.x[1] - self.x[0])
        difference = 0.0
        for across, spacing in zip((self.across_x, self.across_y), spacings, strict=True):
            for other in (across[:, ::-1], -across[::-1]):
                difference = max(difference, float(np.nanmax(np.abs(across - other))) / spacing)
        return difference > _SAME

    def between(self, free: tuple[int, int], held: tuple[int, int]) -> tuple[float, float]:
        """Return the end point of the link from a free node to a held neighbour, m."""
        i, j = free
        k, m = held
        if i == k:
            crossing = self.across_y[int(m > j), i]
            low, high = sorted((self.y[j], self.y[m]))
            return self.x[i], float(np.clip(crossing, low, high))
        crossing = self.across_x[int(k > i), j]
        low, high = sorted((self.x[i], self.x[k]))
        return float(np.clip(crossing, low, high)), self.y[j]


def _boundary_crossings(points: Array, at: Array) -> Array:
    """Return lower and upper crossing (2, n) of a convex polygon with lines at x = `at` (n,), or
    NaN."""
    turned = np.roll(points, -int(points[:, 0].argmin()), axis=0)
    far = int(turned[:, 0].argmax())
    there = turned[: far + 1]
    back = np.concatenate([turned[far:], turned[:1]])[::-1]
    found = [np.interp(at, *pipeline.T, left=np.nan, right=np.nan) for pipeline in (there, back)]
    return np.sort(found, axis=0)


@dataclass(frozen=True)
class _Corner:
    """Corner of a polygon: its position, m, and its node (None: fixed)."""

    position: tuple[float, float]
    node: tuple[int, int] | None


@dataclass(frozen=True)
class _Triangle:
    """Triangle of a cut cell with weight `fraction`. `towards` maps free nodes to fixed ones."""

    corners: tuple[_Corner, _Corner, _Corner]
    fraction: float
    towards: dict[tuple[int, int], tuple[int, int]]


def _triangles(grid: _Crossings, i: int, j: int) -> Iterator[_Triangle]:
    """Yield the triangles of the cut cell that starts at node (i, j)."""
    ring = [(i + a, j + b) for a, b in _CORNERS]
    polygon: list[_Corner] = []
    towards: dict[tuple[int, int], tuple[int, int]] = {}
    for corner, other in zip(ring, (*ring[1:], ring[0]), strict=True):
        if grid.inside[corner]:
            polygon.append(_Corner((grid.x[corner[0]], grid.y[corner[1]]), corner))
        if grid.inside[corner] != grid.inside[other]:
            free = corner if grid.inside[corner] else other
            held = other if grid.inside[corner] else corner
            polygon.append(_Corner(grid.between(free, held), None))
            towards[free] = held
    for part, fraction in _triangulate(polygon):
        yield _Triangle(part, fraction, towards)


def _triangulate(
    polygon: Sequence[_Corner],
) -> Iterator[tuple[tuple[_Corner, _Corner, _Corner], float]]:
    """Split a convex polygon of 3 to 6 corners into triangles; yield each with its weight."""
    count = len(polygon)
    if count <= 4:
        for (a, b, c), fraction in _DIVISIONS[count]:
            yield (polygon[a], polygon[b], polygon[c]), fraction
        return
    # from the free node after a crossing to the free node before the next one
    first = next(k for k in range(count) if polygon[k].node is None and polygon[k - 1].node)
    turned = [*polygon[first - 1 :], *polygon[: first - 1]]
    yield from _triangulate(turned[:4])  # free, crossing, crossing, free
    yield from _triangulate([turned[0], *turned[3:]])


def _group(triangles: Sequence[_Triangle], rows: int, cell: float) -> tuple[Array, float]:
    """Return groups (n, 13, 8) of triangles for the kernel, and their total area."""
    line = _full_groups(rows)
    found = []
    total = 0.0
    for triangle in triangles:
        p = np.array([corner.position for corner in triangle.corners])
        doubled = float(np.linalg.det(p[1:] - p[0]))
        if doubled < _NOTHING * cell:
            continue
        # a displacement's derivatives by those of the corners, from the side opposite to each
        next_ = np.roll(p, -1, axis=0)
        after = np.roll(p, -2, axis=0)
        by_x = (next_ - after)[:, 1] / doubled
        by_y = (after - next_)[:, 0] / doubled
        nodes = [corner.node for corner in triangle.corners]
        node_ids = [0 if node is None else node[0] * line + node[1] for node in nodes]
        links = [_link(nodes[a], nodes[(a + 1) % 3], triangle.towards, line) for a in range(3)]
        area = triangle.fraction * doubled / 2
        total += area
        found.append([area, *by_x, *by_y, *node_ids, *links])
    groups = np.zeros((_full_groups(len(found)), 13))
    groups[: len(found)] = found
    return np.ascontiguousarray(groups.reshape(-1, _TOGETHER, 13).swapaxes(1, 2)), total


def _full_groups(count: int) -> int:
    """Round `count` up to a multiple of the group size."""
    return math.ceil(count / _TOGETHER) * _TOGETHER


def _link(
    one: tuple[int, int] | None,
    other: tuple[int, int] | None,
    towards: dict[tuple[int, int], tuple[int, int]],
    line: int,
) -> int:
    """Return the link that corresponds to a side of a triangle, or 0 if there is none."""
    free = one or other
    if free is None:
        return 0
    if one is None or other is None:
        if free not in towards:
            return 0
        one = free
        other = towards[free]
    (i, j), (k, m) = sorted((one, other))
    is_diagonal = i != k and j != m
    return 0 if is_diagonal else 2 * (i * line + j) + (i == k)
