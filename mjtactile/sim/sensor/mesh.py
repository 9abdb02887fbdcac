"""The membrane's triangle mesh, and the markers that ride on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjtactile.core import geometry
from mjtactile.core.bspline import interpolating
from mjtactile.core.errors import InputError
from mjtactile.core.outline import Outline
from mjtactile.core.types import Array
from mjtactile.quasistatic import QuasistaticMembrane
from mjtactile.quasistatic.interpolation import interpolation_matrix

GRADING = 0.0
"""Relative refinement of the vertex spacing at the center; 0 is a uniform mesh. With 0.25 the force
estimated from the camera images is 10 % low, because the coarser cells bend the markers'
surface."""


@dataclass(frozen=True, eq=False)
class MembraneMesh:
    """Structured triangle mesh of the flat, mounted membrane. Vertex (i, j) has index i * ny + j.

    `p_SV` (n, 3) m are the vertices. `triangles` (m, 3) are counter-clockwise viewed from outside
    (+z). `interior` (k,) are the indices of the moving vertices. `areas` (n,) m^2 is the membrane
    area per vertex. `knots` are the mesh coordinates of its rows and columns, m for a rectangle.
    For another `outline` they are those of the square that is mapped to it.
    """

    nx: int
    ny: int
    p_SV: Array
    triangles: NDArray[np.int64]
    interior: NDArray[np.int64]
    areas: Array
    knots: tuple[Array, Array]
    outline: Outline | None = None

    def coordinates(self, p_SM: Array) -> Array:
        """Return the mesh coordinates (N, 2) of points `p_SM` (N, 3) m of the flat membrane."""
        return p_SM[:, :2] if self.outline is None else self.outline.square(p_SM[:, :2])

    @cached_property
    def inverse_edges(self) -> Array:
        """Inverse (m, 2, 2) 1/m of each flat triangle's two edges (rows: edges, columns: x, y)."""
        corners = self.p_SV[self.triangles]
        return np.linalg.inv(corners[:, 1:, :2] - corners[:, :1, :2])

    @cached_property
    def triangle_areas(self) -> Array:
        """Areas (m,) m^2 of the flat triangles."""
        return 0.5 / np.linalg.det(self.inverse_edges)

    def stretches(self, p_SV: Array, pre_stretch: float) -> tuple[Array, Array]:
        """Return principal stretches (m, 2), relative to the free membrane, and areas (m,) m^2."""
        now = p_SV[self.triangles]
        F = self.inverse_edges @ (now[:, 1:] - now[:, :1])  # rows: dx/dX and dx/dY, (m, 2, 3)
        xx, yy, xy = (np.einsum("ki,ki->k", F[:, i], F[:, j]) for i, j in ((0, 0), (1, 1), (0, 1)))
        mean = (xx + yy) / 2
        spread = np.hypot((xx - yy) / 2, xy)
        squares = np.maximum(np.stack([mean - spread, mean + spread], axis=1), 0.0)
        area = np.sqrt(np.maximum(xx * yy - xy * xy, 0.0)) * self.triangle_areas
        return pre_stretch * np.sqrt(squares), area

    @cached_property
    def spacing(self) -> float:
        """Radius of the disc that fits between the vertices, m: a median in the central half."""
        corners = self.p_SV[self.triangles]
        center = (
            np.abs(corners.mean(axis=1)[:, :2] / np.abs(self.p_SV[:, :2]).max(axis=0)).max(axis=1)
            < 0.5
        )
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        return float(np.median(edges[center].max(axis=1)) / 2)  # of a right triangle


def make_mesh(
    length: float,
    width: float,
    nx: int,
    ny: int,
    *,
    outline: Outline | None = None,
    grading: float = GRADING,
) -> MembraneMesh:
    """Mesh a `length` x `width` m rectangle, or the `outline` in it, with nx x ny vertices.

    Diagonals alternate, so that no direction is favoured. Raises InputError when a side has fewer
    than 5 vertices, for the cubic marker interpolation, or more than 101.
    """
    for name, count in (("nx", nx), ("ny", ny)):
        if not 5 <= count <= 101:
            raise InputError(
                f"{count} vertices along a side; 5 to 101 are needed", source="mesh", field=name
            )
    u, v = (_graded(count, grading) for count in (nx, ny))
    plane = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    if outline is None:
        plane = plane * (length / 2, width / 2)
        knots = (u * length / 2, v * width / 2)
    else:
        plane = outline.plane(plane)
        knots = (u, v)
    p_SV = np.column_stack([plane, np.zeros(nx * ny)])
    triangles = _triangles(nx, ny)
    a, b, c = p_SV[triangles].swapaxes(0, 1)
    area = 0.5 * np.cross(b - a, c - a)[:, 2]
    areas = np.bincount(triangles.ravel(), weights=np.repeat(area / 3, 3), minlength=nx * ny)
    interior = np.arange(nx * ny).reshape(nx, ny)[1:-1, 1:-1].ravel()
    return MembraneMesh(nx, ny, p_SV, triangles, interior, areas, knots, outline)


def _graded(count: int, grading: float) -> Array:
    """Return `count` coordinates from -1 to 1, denser at the center by a smooth map."""
    u = np.linspace(-1, 1, count)
    return (1 - grading) * u + grading * u**3


def _triangles(nx: int, ny: int) -> NDArray[np.int64]:
    index = np.arange(nx * ny).reshape(nx, ny)
    a = index[:-1, :-1]
    b = index[1:, :-1]
    c = index[1:, 1:]
    d = index[:-1, 1:]
    rising = np.add.outer(np.arange(nx - 1), np.arange(ny - 1)) % 2 == 0  # the diagonal a-c
    rising[0, 0] = rising[-1, -1] = True
    rising[0, -1] = rising[-1, 0] = False
    first = np.where(rising[..., None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(rising[..., None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


class MarkerInterpolator:
    """Poses of the rigid marker circles on the deformed mesh.

    A tensor-product cubic spline (not-a-knot) through the vertices, over the mesh coordinates,
    gives position and tangents. This is a fixed linear operator with smooth normals.
    """

    def __init__(self, mesh: MembraneMesh, p_SM: Array):
        """Create the interpolation to marker centers `p_SM` (N, 3), m, on the flat, mounted
        membrane."""
        at = mesh.coordinates(p_SM)
        value_x, slope_x = interpolating(mesh.knots[0], at[:, 0])
        value_y, slope_y = interpolating(mesh.knots[1], at[:, 1])

        def tensor(rows_x: Array, rows_y: Array) -> Array:
            return (rows_x[:, :, None] * rows_y[:, None, :]).reshape(len(p_SM), -1)

        self._operator = np.concatenate(
            [tensor(value_x, value_y), tensor(slope_x, value_y), tensor(value_x, slope_y)]
        )

    @property
    def weights(self) -> Array:
        """Weights (N, n) of the vertices in the marker centers."""
        return self._operator[: len(self._operator) // 3]

    def marker_poses(self, p_SV: Array) -> tuple[Array, Array]:
        """Return centers (N, 3) m and outward unit normals (N, 3) for vertices `p_SV` (n, 3)."""
        p_SM, along_x, along_y = (self._operator @ p_SV).reshape(3, -1, 3)
        normal = geometry.cross(along_x, along_y)
        return p_SM, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def onto_mesh(membrane: QuasistaticMembrane, mesh: MembraneMesh) -> Array | None:
    """Return the displacements (n, nodes) of a mesh's vertices per quasi-static node; None: the
    same points."""
    if membrane.design.frame.outline is None:
        return None
    by_node = interpolation_matrix(membrane, mesh.p_SV[:, :2])
    frame = np.setdiff1d(np.arange(len(mesh.p_SV)), mesh.interior)
    by_node[frame] = 0.0
    return by_node


def normals_of(p_SV: Array, triangles: NDArray[np.int64]) -> Array:
    """Return area-weighted outward unit normals (n, 3) of a membrane at its vertices `p_SV` (n,
    3)."""
    a, b, c = (p_SV[triangles[:, i]] for i in range(3))
    faces = np.cross(b - a, c - a)
    corners = triangles.ravel()
    sums = np.stack(
        [np.bincount(corners, np.repeat(faces[:, i], 3), len(p_SV)) for i in range(3)], axis=1
    )
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)
