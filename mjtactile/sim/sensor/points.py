"""Contact that follows the shape: where, within the piece of sheet that each vertex stands for, its
sphere touches.

Vertices are 2-3 mm apart. Edges, tips and small balls pass between them, and where a tip meets one,
the sheet's finest shape is a tent of that size: a cone is met 40 % too hard. Near what is small or
sharp, therefore,

- a vertex's sphere stands where the object juts farthest into the vertex's own cell (and a little
  beyond, so that none falls between two cells), as if the tent's top were there; the force is the
  vertex's;
- it stands back by as much as a real sheet would be pushed in further than the mesh's tent: a force
  F on a disc of radius a under the tension T deepens a sheet by F/(2 pi T) (ln(1/a) + 1/2), the
  mesh has its own a = 0.198 h (docs/equations.md, C6).

Round objects that are larger than the mesh are left to `facets.StandOff`, faces to the vertices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor import features, shapes
from mjtactile.sim.sensor.mesh import MembraneMesh
from mjtactile.sim.sensor.spread import depth_beyond_mesh, depth_of_neighbours, profile

EVERY = 0.01
SETTLE = 0.02
"""s: how often to look, and the time constant with which they stand back."""
REACH = 0.6
"""Half width of the cell in which a vertex looks for contact, in cells: a little more than a
half."""
_TAKES = 0.52
"""The same for a vertex whose sphere is at home: else two would give a ball between them to each
other for ever."""
_GRID = np.stack(np.meshgrid(*[np.linspace(-REACH, REACH, 7)] * 2, indexing="ij"), axis=-1).reshape(
    -1, 2
)
_AROUND = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
_ZOOMS = (0.1, 0.035, 0.012)  # of a cell: the finer grids
# cells: a sphere stands with all of these on a face
_FOOT = 0.06 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# cells: where it is asked
_BESIDE = 0.3 * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# cells that a shape falls away by there, if it juts out: a ball of two spacings does by 0.03
_JUTS = 0.04
_MISSED = 100.0  # cells, in place of infinity
# cells of height that a detour of one cell costs: of equally high places the nearest to the vertex
# counts
_CENTRED = 0.1
_SLACKEST = 0.01  # strain whose tension is the least to reckon with
_STILL = 1e-5  # m, below which a sphere is back at its vertex
# cells from contact, within which a vertex moves its sphere, and looks
_NEAR = 0.3
_REACHED = 0.8
_SHARP = tuple(
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_BOX,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_MESH,
    )
)
# where a shape is sampled around a contact, in cells
_RINGS = (0.15, 0.373)
_ANGLES = np.arange(8) * np.pi / 4 + 0.2


class _Cells(NamedTuple):
    """Vertices as a shape sees them: `places` (k, 3) m in its frame, `axes` (3, 3) of the sheet,
    the third its outward normal, and `sizes` (k,) m of the vertices' cells."""

    places: Array
    axes: Array
    sizes: Array

    def of(self, rows: NDArray[np.int64]) -> _Cells:
        return _Cells(self.places[rows], self.axes, self.sizes[rows])

    def gaps(self, entry: shapes.Entry, shifts: Array) -> Array:
        """Distances (k, s), in cells, outward to the shape at `shifts` (k, s, 2) in cells from the
        vertices."""
        points = (
            self.places[:, None] + self.sizes[:, None, None] * (shifts @ self.axes[:2])
        ).reshape(-1, 3)
        return (
            entry(points, np.broadcast_to(self.axes[2], points.shape)).reshape(shifts.shape[:2])
            / self.sizes[:, None]
        )


class ContactPoints:
    """Places of one sensor's contact spheres. Call `update` before every step; it works every 10
    ms, near sharp things."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        vertex_geom_ids: NDArray[np.int64],
        body_id: int,
        mesh: MembraneMesh,
        stiffness: float,
    ):
        """`stiffness` E h of the sheet, N/m."""
        self._model = model
        self._data = data
        self._body = body_id
        self._slackest = _SLACKEST * stiffness
        self._first = int(vertex_geom_ids[0])
        self._places = model.geom_pos[
            self._first : self._first + len(vertex_geom_ids)
        ]  # a live view
        # else MuJoCo takes them for their bodies' origins
        model.geom_sameframe[vertex_geom_ids] = 0
        self._triangles = mesh.triangles
        self._interior = mesh.interior
        self._areas = mesh.areas[mesh.interior]
        self._flat = mesh.p_SV[mesh.interior, :2]
        # as stiff with eight triangles as with four
        self._sizes = np.full(len(self._areas), np.sqrt(self._areas.mean()))
        self._shapes = {
            int(geom): entry
            for geom in features.touching_geoms(model, body_id)
            if _is_sharp(model, int(geom), mesh) and (entry := shapes.entry_of(model, int(geom)))
        }
        self._round = {
            geom
            for geom in self._shapes
            if model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_CYLINDER)
            and model.geom_size[geom, 0] >= features.RESOLVED * mesh.spacing
        }
        self._back, self._reach = np.zeros_like(self._places), np.full(len(self._places), _TAKES)
        self._time = float(data.time)
        self._still = True
        # of the sheet when nothing was near: a tent's slopes say nothing of the sheet
        self._upright = self._normals(mesh.p_SV)

    def update(self, p_SV: Array, tensions: Callable[[], Array], pressure_gauge: float) -> None:
        """Follow what is near the vertices at `p_SV` (n, 3) m; `tensions` tells the sheet's (n,)
        N/m where they are needed."""
        time = float(self._data.time)
        elapsed = time - self._time
        if not self._shapes or 0 <= elapsed < EVERY:
            return
        self._time = time
        goal, back, near = self._goals(p_SV, tensions, pressure_gauge)
        if not near and not self._is_touched():
            self._upright = self._normals(p_SV)
            if self._still:
                return
        self._reach = np.where(goal.any(axis=1), REACH, _TAKES)
        self._back += min(abs(elapsed) / SETTLE, 1.0) * (back - self._back)
        self._still = not near and np.abs(self._back).max() < _STILL
        if self._still:
            self._back[:] = 0.0
        self._places[:] = goal + self._back

    def _goals(
        self, p_SV: Array, tensions: Callable[[], Array], pressure_gauge: float
    ) -> tuple[Array, Array, bool]:
        """Vectors (k, 3) m in S to where the spheres should be, those by which to stand back; is
        anything near?"""
        goal = np.zeros_like(self._places)
        behind = np.zeros_like(self._places)
        nearest = np.full(len(self._places), np.inf)
        loads = None
        vertices = p_SV[self._interior]
        for geom, entry in self._shapes.items():
            middle = self._in_sensor(self._data.geom_xpos[geom])
            close = np.flatnonzero(
                np.linalg.norm(vertices - middle, axis=1) - self._model.geom_rbound[geom]
                < self._sizes
            )
            if not len(close):
                continue
            normal = self._upright[close].sum(axis=0)
            axes = _axes(normal / np.linalg.norm(normal))
            cells = self._seen_from(geom, vertices[close], axes, self._sizes[close])
            if geom in self._round:  # but for its ends
                at_end = np.flatnonzero(
                    np.abs(cells.places[:, 2]) + 2 * cells.sizes > self._model.geom_size[geom, 1]
                )
                close = close[at_end]
                cells = cells.of(at_end)
            rows, at, gaps = _deepest(cells, entry, self._reach[close])
            better = gaps < nearest[close[rows]]
            rows = rows[better]
            at = at[better]
            touching = close[rows]
            nearest[touching] = gaps[better]
            goal[touching] = self._sizes[touching, None] * (at @ axes[:2])
            behind[touching] = 0.0
            if len(rows) and int(self._model.geom_type[geom]) in _SHARP:
                loads = self._loads(tensions, pressure_gauge) if loads is None else loads
                pressed = loads[touching] > 0
                rows = rows[pressed]
                at = at[pressed]
                touching = touching[pressed]
                back = _stand_back(cells.of(rows), entry, at, loads[touching], self._flat[touching])
                behind[touching] = -(self._sizes[touching] * back)[:, None] * axes[2]
        return goal, behind, bool(np.isfinite(nearest).any())

    def _is_touched(self) -> bool:
        numbers = self._data.contact.geom - self._first
        return bool(((numbers >= 0) & (numbers < len(self._sizes))).any())

    def _in_sensor(self, p_W: Array) -> Array:
        data = self._data
        return (p_W - data.xpos[self._body]) @ data.xmat[self._body].reshape(3, 3)

    def _seen_from(self, geom: int, vertices: Array, axes: Array, sizes: Array) -> _Cells:
        """Cells around `vertices` (k, 3) m in S, of `sizes` (k,) m, with `axes` (3, 3) in S, as the
        geom sees them."""
        data = self._data
        R_WS = data.xmat[self._body].reshape(3, 3)
        R_WG = data.geom_xmat[geom].reshape(3, 3)
        turn = R_WS.T @ R_WG  # rows are vectors
        shift = (data.xpos[self._body] - data.geom_xpos[geom]) @ R_WG
        return _Cells(vertices @ turn + shift, axes @ turn, sizes)

    def _normals(self, p_SV: Array) -> Array:
        """Outward unit normals (k, 3) of the sheet at the vertices: of the triangles around each,
        by their areas."""
        a, b, c = (p_SV[self._triangles[:, i]] for i in range(3))
        faces = np.cross(b - a, c - a)
        sums = np.stack(
            [
                np.bincount(self._triangles.ravel(), np.repeat(faces[:, i], 3), len(p_SV))
                for i in range(3)
            ],
            axis=1,
        )
        normals = sums[self._interior]
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def _loads(self, tensions: Callable[[], Array], pressure_gauge: float) -> Array:
        """Contact forces on the vertices beyond what the gas carries, over 2 pi times tension and
        cell, (k,)."""
        contact = self._data.contact
        numbers = contact.geom - self._first
        mine = (numbers >= 0) & (numbers < len(self._sizes))
        rows = np.flatnonzero(mine.any(axis=1) & (contact.efc_address >= 0))
        vertices = np.where(mine[rows, 1], numbers[rows, 1], numbers[rows, 0])
        forces = (
            np.bincount(vertices, self._data.efc_force[contact.efc_address[rows]], len(self._sizes))
            if len(rows)
            else 0.0
        )
        tension = np.maximum(tensions()[self._interior], self._slackest)
        return (forces - pressure_gauge * self._areas) / (2 * np.pi * tension * self._sizes)


def _is_sharp(model: mujoco.MjModel, geom: int, mesh: MembraneMesh) -> bool:
    small = features.feature_radius(model, geom) < features.RESOLVED * mesh.spacing
    return small or int(model.geom_type[geom]) in _SHARP


def _axes(normal: Array) -> Array:
    """Unit vectors, rows of (3, 3): two in the plane with this `normal` (3,), the first along x as
    far as it goes; the normal."""
    first = np.array([normal[2], 0.0, -normal[0]])
    first /= max(float(np.linalg.norm(first)), 1e-9)
    return np.stack([first, np.cross(normal, first), normal])


def _deepest(
    cells: _Cells, entry: shapes.Entry, reach: Array
) -> tuple[NDArray[np.int64], Array, Array]:
    """Rows of those cells that a shape juts into; shifts (k, 2), in cells, to where it reaches
    farthest in; gaps (k,) there.

    A shape that reaches farthest in at a cell's border, or beyond its `reach`, does so in the next
    cell, too: along that axis the vertex stays.
    """
    rows = _uneven(cells.gaps(entry, np.broadcast_to(_AROUND, (len(cells.sizes), *_AROUND.shape))))
    if not len(rows):
        return rows, np.zeros((0, 2)), np.zeros(0)
    cells = cells.of(rows)
    grid = np.broadcast_to(_GRID, (len(rows), *_GRID.shape))
    gaps = cells.gaps(entry, grid)
    near = gaps.min(axis=1) < _NEAR
    reach = reach[rows[near]]
    shifts = _least(grid[near], gaps[near])
    rows = rows[near]
    cells = cells.of(np.flatnonzero(near))
    for step in _ZOOMS:
        grid = np.clip(shifts[:, None] + step * _AROUND, -REACH, REACH)
        feet = (grid[:, :, None] + _FOOT).reshape(len(grid), len(_AROUND) * len(_FOOT), 2)
        shifts = _least(
            grid, cells.gaps(entry, feet).reshape(len(grid), len(_AROUND), len(_FOOT)).max(axis=2)
        )
    shifts = np.where(np.abs(shifts) > reach[:, None] - 1e-6, 0.0, shifts)
    juts = _juts(cells, entry, shifts)
    kept = np.flatnonzero(juts.any(axis=1))
    cells = cells.of(kept)
    shifts = np.where(juts[kept], shifts[kept], 0.0)
    return rows[kept], shifts, cells.gaps(entry, shifts[:, None])[:, 0]


def _juts(cells: _Cells, entry: shapes.Entry, at: Array) -> NDArray[np.bool_]:
    """Whether the shape falls away on both sides of `at` (k, 2), along each of the two axes (k, 2):
    not at the edge of a face, where a sphere would now and then be on one side, now on the other,
    of what slides over it."""
    gaps = np.minimum(cells.gaps(entry, at[:, None] + _BESIDE), _MISSED)
    falls = gaps[:, 1:] - gaps[:, :1]
    return np.stack([falls[:, :2].min(axis=1), falls[:, 2:].min(axis=1)], axis=1) > _JUTS


def _uneven(gaps: Array) -> NDArray[np.int64]:
    """Cells that something near bends in sharply, or does not fill, by the gaps (k, 9) at it and
    its neighbours."""
    square = np.minimum(gaps, _MISSED).reshape(-1, 3, 3)
    bends = np.stack(
        [
            square[:, 0] - 2 * square[:, 1] + square[:, 2],
            square[:, :, 0] - 2 * square[:, :, 1] + square[:, :, 2],
        ],
        axis=1,
    ).reshape(-1, 6)
    smooth = (np.abs(bends) < 1 / features.RESOLVED).all(axis=1)
    return np.flatnonzero(~smooth & (gaps.min(axis=1) < _REACHED))


def _least(grid: Array, gaps: Array) -> Array:
    """Of the points `grid` (k, s, 2) those (k, 2) with the smallest gaps (k, s), or nearest to the
    middle of the cell."""
    chosen = (gaps + _CENTRED * (grid * grid).sum(axis=2)).argmin(axis=1)
    return grid[np.arange(len(grid)), chosen]


def _stand_back(cells: _Cells, entry: shapes.Entry, at: Array, loads: Array, flat: Array) -> Array:
    """How far (k,), in cells, the spheres at shifts `at` (k, 2) from the vertices `flat` (k, 2) m
    stand back under `loads`."""
    circle = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
    rings = np.concatenate([np.zeros((1, 2)), *(r * circle for r in _RINGS)])
    gaps = cells.gaps(entry, at[:, None] + rings)
    near, far = (
        np.clip(gaps[:, 1 + i * 8 : 9 + i * 8] - gaps[:, :1], -3 * r, 3 * r)
        for i, r in enumerate(_RINGS)
    )
    # without the sheet's own slope
    even = [np.maximum((rise[:, :4] + rise[:, 4:]) / 2, 0.0) for rise in (near, far)]
    own, radii = depth_beyond_mesh(loads, *profile(even[0], even[1], _RINGS))
    places = flat / cells.sizes[:, None]
    return np.maximum(own + depth_of_neighbours(loads, radii, places, places + at), 0.0)
