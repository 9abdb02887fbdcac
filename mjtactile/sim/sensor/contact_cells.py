"""Contact of a shape with the membrane cells around the vertices. Pure functions.

They compute the point of deepest reach into each cell, and the stand-off of a sphere there. Lengths
are in cells (square root of the area of a vertex), unless m is stated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor import feature_size, ray_intersection, subgrid_indentation

HALF_WIDTH = 0.6
"""Half width of a vertex's contact search cell, in cells: a little more than a half."""
SEARCH_DISTANCE = 0.8
"""Distance from contact within which a vertex searches for it, in cells."""
FOOT = 0.06 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Offsets of a sphere's support points, in cells: on a face all of them rest on it."""
_NEAR = 0.3  # cells from contact, within which a vertex moves its sphere
_GRID = np.stack(
    np.meshgrid(*[np.linspace(-HALF_WIDTH, HALF_WIDTH, 7)] * 2, indexing="ij"), axis=-1
).reshape(-1, 2)
_AROUND = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
_ZOOMS = (0.1, 0.035, 0.012)  # spacings of the finer grids, in cells
# sampled distances, in cells
_BESIDE = 0.3 * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# cells that a shape falls away by there, if it juts out: a ball of two spacings does by 0.03
_JUTS = 0.04
_MISSED = 100.0  # gap in place of infinity, in cells
# height penalty, in cells, per cell of lateral shift: among equally high points the nearest to the
# vertex is chosen
_CENTRED = 0.1
_WIDER = 2.5  # minimum distance ratio to other tips: a pin between vertices is as wide as a cell
# where a shape is sampled around a contact, in cells
_RINGS = (0.15, 0.373)
_ANGLES = np.arange(8) * np.pi / 4


class Cells(NamedTuple):
    """Vertices in the frame of a shape: `positions` (k, 3) m, the membrane's `axes` (3, 3), and
    the `sizes` (k,) m of the cells. The third axis is the outward normal."""

    positions: Array
    axes: Array
    sizes: Array

    def of(self, rows: NDArray[np.int64]) -> Cells:
        return Cells(self.positions[rows], self.axes, self.sizes[rows])

    def gaps(self, entry: ray_intersection.Entry, shifts: Array) -> Array:
        """Return the distances (k, s), in cells, outward to the shape at `shifts` (k, s, 2) from
        the vertices."""
        points = (
            self.positions[:, None] + self.sizes[:, None, None] * (shifts @ self.axes[:2])
        ).reshape(-1, 3)
        return (
            entry(points, np.broadcast_to(self.axes[2], points.shape)).reshape(shifts.shape[:2])
            / self.sizes[:, None]
        )


def axes_of(normal: Array) -> Array:
    """Return unit vectors, rows of (3, 3), of a plane with this `normal` (3,): the first in the
    plane and as close to x as possible, the third the normal."""
    first = np.array([normal[2], 0.0, -normal[0]])
    first /= max(float(np.linalg.norm(first)), 1e-9)
    return np.stack([first, np.cross(normal, first), normal])


def initial_offsets(
    cells: Cells, entry: ray_intersection.Entry, core: Array
) -> tuple[Array, Array]:
    """Return shifts (k, 2) to the deepest point of a thin shape in each cell, and gaps (k,).

    The points `core` (m, 3) m represent the shape. Gaps are `_MISSED` where no point is in the
    cell.
    """
    outward = cells.axes[2]
    heights = core @ outward + entry(core, np.broadcast_to(outward, core.shape))
    shifts = (core @ cells.axes[:2].T)[None] - (cells.positions @ cells.axes[:2].T)[:, None]
    shifts /= cells.sizes[:, None, None]
    gaps = (heights - (cells.positions @ outward)[:, None]) / cells.sizes[:, None]
    gaps = np.where(np.abs(shifts).max(axis=2) < HALF_WIDTH, gaps, _MISSED)
    chosen = (gaps + _CENTRED * (shifts * shifts).sum(axis=2)).argmin(axis=1)
    row = np.arange(len(chosen))
    return shifts[row, chosen], gaps[row, chosen]


def deepest(
    cells: Cells,
    entry: ray_intersection.Entry,
    limits: Array,
    foot: Array,
    hints: tuple[Array, Array] | None,
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the rows of the cells into which a shape protrudes, the shifts and the gaps.

    The shifts (k, 2) lead to the deepest point, the gaps (k,) are those there. A deepest point at a
    cell's border, or beyond its `limits`, also belongs to the next cell. The vertex then does not
    move along that axis. All points `foot` (f, 2) of a sphere rest on the shape. `hints` are shifts
    and gaps of a thin shape.
    """
    uneven = _uneven(
        cells.gaps(entry, np.broadcast_to(_AROUND, (len(cells.sizes), *_AROUND.shape)))
    )
    rows = uneven if hints is None else np.union1d(uneven, np.flatnonzero(hints[1] < _NEAR))
    if not len(rows):
        return rows, np.zeros((0, 2)), np.zeros(0)
    cells = cells.of(rows)
    grid = np.broadcast_to(_GRID, (len(rows), *_GRID.shape))
    gaps = cells.gaps(entry, grid)
    if hints is not None:
        grid = np.concatenate([grid, hints[0][rows, None]], axis=1)
        gaps = np.concatenate([gaps, hints[1][rows, None]], axis=1)
    near = gaps.min(axis=1) < _NEAR
    limits = limits[rows[near]]
    shifts = _minimum(grid[near], gaps[near])
    rows = rows[near]
    cells = cells.of(np.flatnonzero(near))
    for step in _ZOOMS:
        grid = np.clip(shifts[:, None] + step * _AROUND, -HALF_WIDTH, HALF_WIDTH)
        feet = (grid[:, :, None] + foot).reshape(len(grid), len(_AROUND) * len(foot), 2)
        shifts = _minimum(
            grid, cells.gaps(entry, feet).reshape(len(grid), len(_AROUND), len(foot)).max(axis=2)
        )
    shifts = np.where(np.abs(shifts) > limits[:, None] - 1e-6, 0.0, shifts)
    juts = _juts(cells, entry, shifts, 1.0 if hints is None else _WIDER)
    kept = np.flatnonzero(juts.any(axis=1))
    cells = cells.of(kept)
    at = np.where(juts[kept], shifts[kept], 0.0)
    gaps = cells.gaps(entry, at[:, None])[:, 0]
    if hints is not None:  # at the end of a thin shape, the vertex would stay next to it
        missed = gaps >= _MISSED
        at[missed] = shifts[kept[missed]]
        gaps[missed] = cells.of(np.flatnonzero(missed)).gaps(entry, at[missed, None])[:, 0]
    return rows[kept], at, gaps


def standoff(
    cells: Cells,
    entry: ray_intersection.Entry,
    at: Array,
    loads: Array,
    flat: Array,
    *,
    turns: Array | float = 0.2,
    width: float = 0.0,
) -> Array:
    """Return the stand-off (k,) of the spheres under `loads`.

    The spheres are at shifts `at` (k, 2) from the vertices `flat` (k, 2) m. For a thin shape,
    `turns` (k,) are its angles in the membrane plane, and `width` is half the width of its contact
    face.
    """
    angles = _ANGLES + np.broadcast_to(turns, len(at))[:, None]
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    rings = np.concatenate([np.zeros((len(at), 1, 2)), *(r * circle for r in _RINGS)], axis=1)
    gaps = cells.gaps(entry, at[:, None] + rings)
    near, far = (
        np.clip(gaps[:, 1 + i * 8 : 9 + i * 8] - gaps[:, :1], -3 * r, 3 * r)
        for i, r in enumerate(_RINGS)
    )
    # averages over opposite directions, which remove the membrane's own slope
    even = [np.maximum((rise[:, :4] + rise[:, 4:]) / 2, 0.0) for rise in (near, far)]
    shape = subgrid_indentation.profile(even[0], even[1], _RINGS)
    depths, radii = subgrid_indentation.depth_beyond_mesh(loads, *shape, width)
    positions = flat / cells.sizes[:, None]
    others = subgrid_indentation.depth_of_neighbours(loads, radii, positions, positions + at)
    return np.maximum(depths + others, 0.0)


def angles_of(cells: Cells, core: Array, at: Array) -> Array:
    """Return the angles (k,) in the membrane plane of a thin shape near the shifts `at` (k, 2).

    They are computed from the points `core` (m, 3) m inside, and arbitrary for a shape on end.
    """
    flat = cells.axes[:2]
    offsets = ((core @ flat.T)[None] - (cells.positions @ flat.T)[:, None]) / cells.sizes[
        :, None, None
    ]
    offsets -= at[:, None]
    near = (np.linalg.norm(offsets, axis=2) < subgrid_indentation.MAX_RADIUS).astype(float)
    xx, yy, xy = (
        (near * offsets[..., i] * offsets[..., j]).sum(axis=1) for i, j in ((0, 0), (1, 1), (0, 1))
    )
    return np.arctan2(2 * xy, xx - yy) / 2


def _juts(
    cells: Cells, entry: ray_intersection.Entry, at: Array, wider: float
) -> NDArray[np.bool_]:
    """Return True (k, 2) where the shape falls away on both sides of `at` (k, 2), for each axis.

    The edge of a face does not count: a sphere would alternate between both sides of it.
    """
    gaps = np.minimum(cells.gaps(entry, at[:, None] + wider * _BESIDE), _MISSED)
    falls = gaps[:, 1:] - gaps[:, :1]
    return np.stack([falls[:, :2].min(axis=1), falls[:, 2:].min(axis=1)], axis=1) > _JUTS


def _uneven(gaps: Array) -> NDArray[np.int64]:
    """Return the cells that a near shape bends sharply or does not fill, by the gaps (k, 9)."""
    square = np.minimum(gaps, _MISSED).reshape(-1, 3, 3)
    bends = np.stack(
        [
            square[:, 0] - 2 * square[:, 1] + square[:, 2],
            square[:, :, 0] - 2 * square[:, :, 1] + square[:, :, 2],
        ],
        axis=1,
    ).reshape(-1, 6)
    smooth = (np.abs(bends) < 1 / feature_size.RESOLVED).all(axis=1)
    return np.flatnonzero(~smooth & (gaps.min(axis=1) < SEARCH_DISTANCE))


def _minimum(grid: Array, gaps: Array) -> Array:
    """Return the points (k, 2) of `grid` with the smallest gaps (k, s), nearest the cell's
    center."""
    chosen = (gaps + _CENTRED * (grid * grid).sum(axis=2)).argmin(axis=1)
    return grid[np.arange(len(grid)), chosen]
