"""Membrane heights next to the pressure center, from the marker heights of any layout
(docs/theory/contact_shape.md, Eq. F27)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array

_STEP = 1e-3  # grid of the interpolated heights, m
_SIDE = 9  # nodes along a side of the view
_SPACING = 2.2e-3  # distance of these nodes, m
_PAD = 12  # grid steps around the frame, where the height is zero
_BORDER = 96  # points on the frame, where the height is zero
_UNIT = 1e-2  # m
_COMPONENTS = 32  # principal components that complete missing markers, at most
_LINE = _SPACING / _STEP * (np.arange(_SIDE) - (_SIDE - 1) / 2)
_NODES = np.stack(np.meshgrid(_LINE, _LINE, indexing="ij"), axis=-1).reshape(-1, 2)  # grid steps


@dataclass(frozen=True, eq=False)
class PressView:
    """Heights next to the pressure center.

    `spread` (g, N) interpolates marker heights to a grid of `shape` nodes. The grid starts at
    `corner` (2,), m. `moments` (3, N) gives force, N, and its moments, N mm. `rows` (c, N), m, are
    principal components of the marker heights. `sd`, m, is the noise of a height.
    """

    spread: Array
    shape: tuple[int, int]
    corner: Array
    moments: Array
    rows: Array
    sd: float

    @classmethod
    def of(
        cls, design: SensorDesign, heights: Array, force: Array, center: Array, sd: float
    ) -> PressView:
        """Create the view of a sensor from presses. They have marker `heights` (n, N), m, normal
        `force` (n,), N, and pressure `center` (n, 2), mm."""
        # relative errors count
        required = np.column_stack([np.ones(len(force)), center])
        relative = heights / force[:, None]
        noise = (sd / float(np.median(force))) ** 2 * np.eye(heights.shape[1])
        normal = relative.T @ relative + len(force) * noise
        moments = np.linalg.solve(normal, relative.T @ required).T
        count = min(_COMPONENTS, heights.shape[1])
        _, values, rows = np.linalg.svd(heights, full_matrices=False)
        scaled = (values[:count] / math.sqrt(len(heights)))[:, None] * rows[:count]
        return cls.with_moments(design, moments, scaled, sd)

    @classmethod
    def with_moments(
        cls, design: SensorDesign, moments: Array, rows: Array, sd: float
    ) -> PressView:
        """Create the view of a sensor; for the arguments see the class."""
        frame = design.frame
        half = np.array([frame.length, frame.width]) / 2
        counts = np.floor(2 * half / _STEP).astype(int) + 1
        corner = -_STEP * (counts - 1) / 2
        lines = [
            start + _STEP * np.arange(count) for start, count in zip(corner, counts, strict=True)
        ]
        grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
        border = _rectangle(half) if frame.outline is None else frame.outline.points(_BORDER)
        spread = _thin_plate(design.markers.p_SM[:, :2], border, grid)
        shape = (int(counts[0]), int(counts[1]))
        return cls(spread.astype(np.float32), shape, corner, moments, rows, sd)

    def completed(self, heights: Array, ids: NDArray[np.int64]) -> Array:
        """Return the likeliest heights of all markers (N,), m. `heights` (n,) are those of
        `ids`."""
        complete = np.zeros(self.rows.shape[1])
        if len(ids) < len(complete):
            rows = self.rows[:, ids]
            H = rows @ rows.T / self.sd**2 + np.eye(len(rows))
            complete = np.linalg.solve(H, rows @ heights / self.sd**2) @ self.rows
        complete[ids] = heights
        return complete

    def __call__(self, heights: Array) -> tuple[Array, Array]:
        """Return the inputs of the network (n, k) and approximate pressure centers (n, 2), mm.

        The inputs are the heights around the center, and their ratios. Then follow the logarithms
        of length and force, and the center. `heights` (n, N), m, are those of the markers.
        """
        sums = heights @ self.moments.T
        limit = -1e3 * self.corner
        positive = np.maximum(sums[:, :1], 1e-2)
        center = np.clip(sums[:, 1:] / positive, -limit, limit)
        field = (1e3 * heights).astype(np.float32) @ self.spread.T
        sides = [count + 2 * _PAD for count in self.shape]
        padded = np.zeros((len(field), *sides), np.float32)
        padded[:, _PAD:-_PAD, _PAD:-_PAD] = field.reshape(-1, *self.shape)
        view = _sampled(padded, (1e-3 * center - self.corner) / _STEP + _PAD)
        length = np.sqrt((view**2).sum(axis=1, keepdims=True)) + 1e-4
        position = 0.1 * center
        level = np.log(np.hstack([length, positive]))
        inputs = np.hstack([view, view / length, level, position, position**2])
        return inputs.astype(np.float32), center


def _sampled(field: Array, center: Array) -> Array:
    """Return the values (n, _SIDE**2) of fields (n, a, b) around `center` (n, 2), grid steps."""
    at = np.clip(center[:, None] + _NODES, 0, np.array(field.shape[1:]) - 1.001)
    low = at.astype(int)
    weight = (at - low).astype(np.float32)
    columns = field.shape[2]
    first = columns * low[..., 0] + low[..., 1]
    u, v = weight[..., 0], weight[..., 1]
    flat = field.reshape(len(field), -1)

    def after(step: int) -> Array:
        return np.take_along_axis(flat, first + step, axis=1)

    back = after(0) * (1 - v) + after(1) * v
    front = after(columns) * (1 - v) + after(columns + 1) * v
    return back * (1 - u) + front * u


def _rectangle(half: Array) -> Array:
    """Return points (n, 2) on the sides of a rectangle with half sides `half` (2,)."""
    line = np.linspace(-1, 1, _BORDER // 4, endpoint=False)
    ones = np.ones_like(line)
    sides = [(line, -ones), (ones, line), (-line, ones), (-ones, -line)]
    return half * np.concatenate([np.column_stack(side) for side in sides])


def _thin_plate(points: Array, border: Array, grid: Array) -> Array:
    """Return the matrix (g, N) of a thin-plate spline, from `points` (N, 2), m, to `grid` (g, 2),
    m. The spline is zero at `border` (b, 2), m."""
    nodes = np.vstack([points, border])
    count = len(nodes)
    linear = np.column_stack([np.ones(count), nodes / _UNIT])
    system = np.zeros((count + 3, count + 3))
    system[:count, :count] = _kernel(nodes, nodes) + 1e-9 * np.eye(count)
    system[:count, count:] = linear
    system[count:, :count] = linear.T
    to_grid = np.hstack([_kernel(grid, nodes), np.ones((len(grid), 1)), grid / _UNIT])
    return np.linalg.solve(system.T, to_grid.T).T[:, : len(points)]


def _kernel(a: Array, b: Array) -> Array:
    square = (((a[:, None] - b[None]) / _UNIT) ** 2).sum(axis=-1)
    return square * np.log(np.maximum(square, 1e-20))
