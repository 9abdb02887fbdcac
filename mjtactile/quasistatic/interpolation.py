"""Interpolation between the nodes of a quasi-static membrane: cubic splines through all nodes.

Nodes outside a non-rectangular outline are fixed at zero, so a spline would have a kink there.
Displacements are therefore extrapolated beyond the outline by a quadratic polynomial. It is fitted
to the free nodes and outline points near the closest point of the outline.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.bspline import interpolating
from mjtactile.core.types import Array
from mjtactile.quasistatic.cut_cells import free_nodes
from mjtactile.quasistatic.membrane import QuasistaticMembrane

_BEYOND = 4.0  # spacings that are continued; a spline forgets to a quarter with each
_ABOUT = 3.0  # radius of the fitted region around the nearest rim point, spacings
_POINTS = 1440  # of the outline
_SPACING = 0.7  # spacings, of those that are fitted


def interpolation_matrix(membrane: QuasistaticMembrane, positions: Array) -> Array:
    """Return the matrix (n, nx * ny) from node displacements to points `positions` (n, 2) m.

    It is zero on the frame.
    """
    by_node = interpolation_matrix_with_gradient(membrane, positions)[0]
    outline = membrane.design.frame.outline
    if outline is None:
        return by_node
    return np.where(outline.distance(positions)[:, None] > 0, by_node, 0.0)


def interpolation_matrix_with_gradient(membrane: QuasistaticMembrane, positions: Array) -> Array:
    """Return matrices (3, n, nx * ny) of displacements at `positions` (n, 2) m and their slopes,
    1/m."""
    (across, across_by), (along, along_by) = (
        interpolating(line, np.clip(at, line[0], line[-1]))
        for line, at in zip(
            (membrane.x, membrane.y), np.asarray(positions, dtype=float).T, strict=True
        )
    )
    pairs = ((across, along), (across_by, along), (across, along_by))
    by_node = np.array([(a[:, :, None] * b[:, None, :]).reshape(len(a), -1) for a, b in pairs])
    if membrane.design.frame.outline is None:
        return by_node
    outside, by_free = _extrapolation(membrane)
    return by_node + by_node[:, :, outside] @ by_free


def _extrapolation(membrane: QuasistaticMembrane) -> tuple[Array, Array]:
    """Return nodes (m,) just outside an outline, and their extrapolation matrix (m, nx * ny)."""
    outline = membrane.design.frame.outline
    assert outline is not None
    spacing = np.array([membrane.x[1] - membrane.x[0], membrane.y[1] - membrane.y[0]])
    nodes = np.stack(np.meshgrid(membrane.x, membrane.y, indexing="ij"), axis=-1).reshape(-1, 2)
    free = free_nodes(membrane._cut, membrane.grid).ravel()
    rim = outline.points(_POINTS)
    length = np.linalg.norm(rim - np.roll(rim, 1, axis=0), axis=1).sum()
    fitted = rim[:: max(int(_SPACING * spacing.min() / length * _POINTS), 1)] / spacing
    inner = np.flatnonzero(free)
    candidates = np.flatnonzero(~free & (outline.distance(nodes) > -_BEYOND * spacing.max()))
    by_free = np.zeros((len(candidates), len(nodes)))
    for row, node in enumerate(candidates):
        center = rim[np.square((rim - nodes[node]) / spacing).sum(axis=1).argmin()] / spacing
        near = inner[np.square(nodes[inner] / spacing - center).sum(axis=1) < _ABOUT**2]
        held = fitted[np.square(fitted - center).sum(axis=1) < _ABOUT**2]
        offsets = np.concatenate([nodes[near] / spacing, held]) - center
        fit = np.linalg.pinv(_powers(offsets))[:, : len(near)]
        by_free[row, near] = (_powers(nodes[node][None] / spacing - center) @ fit)[0]
    return candidates, by_free


def _powers(offsets: Array) -> Array:
    x, y = offsets.T
    return np.column_stack([np.ones(len(offsets)), x, y, x**2, x * y, y**2])
