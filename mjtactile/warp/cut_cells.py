"""Triangles of the cells that an outline cuts, for the device (X8)."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mjtactile.core.types import Array
from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.warp.arrays import floats, ints
from mjtactile.warp.device.grid import CutCells
from mjtactile.warp.stencil import stress

_HEADER = 2  # values before the nodes in the array of `quasistatic.cut_cells.cut_grid`
_STEP = 1e-6  # difference of displacement gradients


def cut_cells(membrane: QuasistaticMembrane) -> tuple[Any, Array]:
    """Return the triangles for the device, and the state (N,) of each node: 1 free, 0 or -1."""
    nx, ny = membrane.grid
    nodes = nx * ny
    if not membrane._cut.size:
        state = np.zeros((nx, ny), int)
        state[1:-1, 1:-1] = 1
        return _pack(np.ones(nodes), np.zeros((0, 13)), np.zeros((0, 3), int), nodes), state.ravel()
    state, whole, groups = np.split(membrane._cut[_HEADER:], [nodes, 2 * nodes])
    rows = groups.reshape(-1, 13, 8).swapaxes(1, 2).reshape(-1, 13)
    rows = rows[rows[:, 0] > 0]
    line = -(-ny // 8) * 8  # lines of nodes are padded there
    corners = rows[:, 7:10].astype(int)
    corners = np.where(corners > 0, corners // line * ny + corners % line, -1)
    made = _pack(whole, rows, corners, nodes, line, ny)
    stiffness = np.zeros(nodes)
    for row, corner_nodes in zip(rows, corners, strict=True):
        for a in np.flatnonzero(corner_nodes >= 0):
            stiffness[corner_nodes[a]] += row[0] * _stiffness(membrane, row[1 + a], row[4 + a])
    made.held = floats(stiffness)
    return made, state.astype(int)


def _pack(whole: Array, rows: Array, corners: Array, nodes: int, line: int = 1, ny: int = 1) -> Any:
    made = CutCells()
    made.count = len(rows)
    made.whole = floats(whole)
    made.held = wp.zeros(nodes, dtype=float)
    # an empty array has no address
    made.area = floats(rows[:, 0] if len(rows) else [0.0])
    slopes = np.stack([rows[:, 1:4], rows[:, 4:7]], axis=-1).reshape(-1, 2)
    made.slopes = wp.array(np.vstack([slopes, np.zeros((1, 2))]).astype(np.float32), dtype=wp.vec2)
    made.nodes = ints([*corners.ravel(), -1])
    entries = np.flatnonzero(corners.ravel() >= 0)
    made.first_corner, made.corners = _by_node(corners.ravel()[entries], entries, nodes)
    links = rows[:, 10:13].astype(int).ravel()
    sides = np.flatnonzero(links > 0)
    padded = links[sides] // 2
    at = padded // line * ny + padded % line
    made.first_side, made.sides = _by_node(at, 2 * sides + links[sides] % 2, nodes)
    return made


def _by_node(at: Array, values: Array, nodes: int) -> tuple[Any, Any]:
    """Return the first index (nodes + 1,) of each node, and the values in the nodes' order."""
    order = np.argsort(at, kind="stable")
    first = np.searchsorted(at[order], np.arange(nodes + 1))
    return ints(first), ints([*values[order], 0])


def _stiffness(membrane: QuasistaticMembrane, by_x: float, by_y: float) -> float:
    """Return the larger in-plane stiffness per area, N/m^3, at a corner of a triangle at rest."""
    slopes = np.array([by_x, by_y])
    found = 0.0
    for axis in range(2):
        moved = np.zeros((2, 2))
        moved[axis] = _STEP * slopes / np.linalg.norm(slopes)
        forces = [
            (F @ stress(membrane, F) @ slopes)[axis] for F in (np.eye(2) + moved, np.eye(2) - moved)
        ]
        found = max(found, (forces[0] - forces[1]) / (2 * _STEP) * float(np.linalg.norm(slopes)))
    return found
