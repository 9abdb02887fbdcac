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
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor import cores, features, shapes
from mjtactile.sim.sensor.mesh import MembraneMesh
from mjtactile.sim.sensor.spread import WIDEST, depth_beyond_mesh, depth_of_neighbours, profile

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
_WIDER = 2.5  # than where else a shape juts: a pin that fits between vertices is as wide as a cell
_MOST_FACES = 4000  # of the hull of something thin
_PACE = 7.5e-3  # m/s, with which they stand back from what is thin: contact must not be lost
_EASE = 0.5  # of a change of a load, that a look follows
_APART = 0.15  # cells between points inside of what is thin
_BLUNT = (
    0.3  # cells: radius of a sphere that meets what is thin, with its top where the sheet is: a
)
# sheet under pressure jumps by a tenth of a cell, and would be in it, and be pushed out sideways
_HALF = 0.5  # of a thin thing's half width, within which a sphere's feet stand on it
# where a shape is sampled around a contact, in cells
_RINGS = (0.15, 0.373)
_ANGLES = np.arange(8) * np.pi / 4


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


def missed(model: mujoco.MjModel, carrier: int, mesh: MembraneMesh) -> tuple[float, str]:
    """Radius, m, and name of the thinnest thing that could slip between vertices, since its shape
    is not known here (a mesh of too many faces); infinite when there is none."""
    limit = features.SLIPS * mesh.spacing
    found = [
        (radius, features.name_of(model, int(geom)))
        for geom in features.touching_geoms(model, carrier)
        if (radius := features.feature_radius(model, int(geom))) < limit
        and shapes.entry_of(model, int(geom), _MOST_FACES) is None
    ]
    return min(found, default=(np.inf, ""))


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
        thin = {
            int(geom): features.feature_radius(model, int(geom)) < features.SLIPS * mesh.spacing
            for geom in features.touching_geoms(model, body_id)
        }
        self._shapes = {
            geom: entry
            for geom in thin
            if _is_sharp(model, geom, mesh)
            and (entry := shapes.entry_of(model, geom, _MOST_FACES if thin[geom] else None))
        }
        self._round = {
            geom
            for geom in self._shapes
            if model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_CYLINDER)
            and model.geom_size[geom, 0] >= features.RESOLVED * mesh.spacing
        }
        self._cores = {
            geom: cores.core(model, geom, _APART * self._sizes[0])
            for geom in self._shapes
            if thin[geom]
        }
        """Points inside of what is thin: it may lie between all places where a cell looks."""
        self._every = EVERY
        self._eased = np.zeros(len(vertex_geom_ids))  # loads, as what is thin bears them
        self._radius = float(model.geom_size[self._first, 0])
        self._blunt = max(_BLUNT * float(self._sizes[0]), self._radius)
        block = slice(self._first, self._first + len(vertex_geom_ids))
        self._radii = model.geom_size[block, 0]  # live views
        self._bounds = model.geom_rbound[block]
        self._boxes = model.geom_aabb[block, 3:]
        if self._cores:
            _widen(model, model.geom_bodyid[vertex_geom_ids], self._sizes[0])
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
        if not self._shapes or 0 <= elapsed < self._every:
            return
        self._time = time
        self._every = EVERY
        goal, back, blunt, gaps = self._goals(p_SV, tensions, pressure_gauge)
        near = bool(np.isfinite(gaps).any())
        if self._cores:
            self._take(blunt, gaps)
        if not near and not self._is_touched():
            self._upright = self._normals(p_SV)
            if self._still:
                return
        self._reach = np.where(goal.any(axis=1), REACH, _TAKES)
        moves = min(abs(elapsed) / SETTLE, 1.0) * (back - self._back)
        if self._cores:
            most = _PACE * abs(elapsed)
            moves = np.where(blunt[:, None], np.clip(moves, -most, most), moves)
        self._back += moves
        self._still = not near and np.abs(self._back).max() < _STILL
        if self._still:
            self._back[:] = 0.0
        self._places[:] = goal + self._back

    def _goals(
        self, p_SV: Array, tensions: Callable[[], Array], pressure_gauge: float
    ) -> tuple[Array, Array, NDArray[np.bool_], Array]:
        """Vectors (k, 3) m in S to where the spheres should be, those by which to stand back, which
        spheres are blunt; gaps (k,), in cells, to what each is to touch."""
        goal = np.zeros_like(self._places)
        behind = np.zeros_like(self._places)
        blunt = np.zeros(len(self._places), dtype=bool)
        nearest = np.full(len(self._places), np.inf)
        loads = None
        vertices = p_SV[self._interior]
        for geom, entry in self._shapes.items():
            middle = self._in_sensor(self._data.geom_xpos[geom])
            close = np.flatnonzero(
                np.linalg.norm(vertices - middle, axis=1) - self._model.geom_rbound[geom]
                < self._sizes
            )
            if not len(close) or self._is_far(geom, vertices[close]):
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
            hints = None
            foot = _FOOT
            if geom in self._cores:
                hints = _hints(cells, entry, self._cores[geom])
                thin = features.feature_radius(self._model, geom) / self._sizes[0]
                foot = min(1.0, _HALF * thin / np.abs(_FOOT).max()) * _FOOT
                if hints[1].min(initial=np.inf) < _REACHED:
                    self._every = (
                        EVERY if self._is_touched() else 0.0
                    )  # it is met from the first step
            rows, at, gaps = _deepest(cells, entry, self._reach[close], foot, hints)
            better = gaps < nearest[close[rows]]
            rows = rows[better]
            at = at[better]
            touching = close[rows]
            nearest[touching] = gaps[better]
            goal[touching] = self._sizes[touching, None] * (at @ axes[:2])
            behind[touching] = 0.0
            blunt[touching] = geom in self._cores
            if geom in self._cores:
                goal[touching] -= (self._blunt - self._radius) * axes[2]
            if len(rows) and int(self._model.geom_type[geom]) in _SHARP:
                if loads is None:
                    loads = self._loads(tensions, pressure_gauge)
                    self._ease(loads)
                bearing = self._eased if geom in self._cores else loads
                pressed = bearing[touching] > 0
                rows = rows[pressed]
                at = at[pressed]
                touching = touching[pressed]
                shape: dict[str, Any] = {}
                if geom in self._cores:
                    shape["turns"] = _lie(cells.of(rows), self._cores[geom], at)
                    shape["width"] = self._width(geom, cells.axes[2]) / self._sizes[0]
                back = _stand_back(
                    cells.of(rows), entry, at, bearing[touching], self._flat[touching], **shape
                )
                behind[touching] = -(self._sizes[touching] * back)[:, None] * axes[2]
        return goal, behind, blunt, nearest

    def _take(self, blunt: NDArray[np.bool_], gaps: Array) -> None:
        """Have the spheres of these vertices be `blunt`, and those others small again. What is in
        a vertex's cell already when the vertex takes it is met where it is, and lifted then."""
        sunk = blunt & (self._radii == self._radius) & (gaps < 0)
        self._back[sunk] = 0.0
        self._back[sunk, 2] = self._sizes[sunk] * gaps[sunk]
        radii = np.where(blunt, self._blunt, self._radius)
        self._radii[:] = radii
        self._bounds[:] = radii
        self._boxes[:] = radii[:, None]

    def _ease(self, loads: Array) -> None:
        """Follow `loads` (k,) slowly: a contact that is lost for a step must not come back with
        another stand-back."""
        self._eased += _EASE * (np.maximum(loads, 0.0) - self._eased)

    def _is_touched(self) -> bool:
        numbers = self._data.contact.geom - self._first
        return bool(((numbers >= 0) & (numbers < len(self._sizes))).any())

    def _width(self, geom: int, outward: Array) -> float:
        """Half width, m, of the flat face with which something thin presses along the unit vector
        `outward` of its frame; 0 of what is round."""
        kind = int(self._model.geom_type[geom])
        if kind == int(mujoco.mjtGeom.mjGEOM_BOX):
            return features.feature_radius(self._model, geom)
        on_end = abs(float(outward[2])) > features.END
        if kind == int(mujoco.mjtGeom.mjGEOM_CYLINDER) and on_end:
            return float(self._model.geom_size[geom, 0])
        return 0.0

    def _is_far(self, geom: int, vertices: Array) -> bool:
        """Whether the box around a geom, which fills little of its ball, is two cells away."""
        data = self._data
        p_WV = data.xpos[self._body] + vertices @ data.xmat[self._body].reshape(3, 3).T
        away = features.box_distances(self._model, data, geom, p_WV)
        return bool(away.min() > 2 * self._sizes[0])

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


def _widen(model: mujoco.MjModel, bodies: NDArray[np.int64], size: float) -> None:
    """Have MuJoCo look for contacts of each vertex as far as its sphere may be moved to."""
    for body in bodies:
        first = int(model.body_bvhadr[body])
        model.bvh_aabb[first : first + model.body_bvhnum[body], 3:] = size


def _is_sharp(model: mujoco.MjModel, geom: int, mesh: MembraneMesh) -> bool:
    small = features.feature_radius(model, geom) < features.RESOLVED * mesh.spacing
    return small or int(model.geom_type[geom]) in _SHARP


def _axes(normal: Array) -> Array:
    """Unit vectors, rows of (3, 3): two in the plane with this `normal` (3,), the first along x as
    far as it goes; the normal."""
    first = np.array([normal[2], 0.0, -normal[0]])
    first /= max(float(np.linalg.norm(first)), 1e-9)
    return np.stack([first, np.cross(normal, first), normal])


def _hints(cells: _Cells, entry: shapes.Entry, core: Array) -> tuple[Array, Array]:
    """Shifts (k, 2), in cells, to where something thin, with the points `core` (m, 3) m inside,
    reaches farthest into each cell; gaps (k,) there, `_MISSED` where it does not."""
    outward = cells.axes[2]
    heights = core @ outward + entry(core, np.broadcast_to(outward, core.shape))
    shifts = (core @ cells.axes[:2].T)[None] - (cells.places @ cells.axes[:2].T)[:, None]
    shifts /= cells.sizes[:, None, None]
    gaps = (heights - (cells.places @ outward)[:, None]) / cells.sizes[:, None]
    gaps = np.where(np.abs(shifts).max(axis=2) < REACH, gaps, _MISSED)
    chosen = (gaps + _CENTRED * (shifts * shifts).sum(axis=2)).argmin(axis=1)
    row = np.arange(len(chosen))
    return shifts[row, chosen], gaps[row, chosen]


def _deepest(
    cells: _Cells, entry: shapes.Entry, reach: Array, foot: Array, hints: tuple[Array, Array] | None
) -> tuple[NDArray[np.int64], Array, Array]:
    """Rows of those cells that a shape juts into; shifts (k, 2), in cells, to where it reaches
    farthest in; gaps (k,) there.

    A shape that reaches farthest in at a cell's border, or beyond its `reach`, does so in the next
    cell, too: along that axis the vertex stays. A sphere stands with all of its `foot` (f, 2), in
    cells, on the shape; `hints` are shifts and gaps of what is thin.
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
    reach = reach[rows[near]]
    shifts = _least(grid[near], gaps[near])
    rows = rows[near]
    cells = cells.of(np.flatnonzero(near))
    for step in _ZOOMS:
        grid = np.clip(shifts[:, None] + step * _AROUND, -REACH, REACH)
        feet = (grid[:, :, None] + foot).reshape(len(grid), len(_AROUND) * len(foot), 2)
        shifts = _least(
            grid, cells.gaps(entry, feet).reshape(len(grid), len(_AROUND), len(foot)).max(axis=2)
        )
    shifts = np.where(np.abs(shifts) > reach[:, None] - 1e-6, 0.0, shifts)
    juts = _juts(cells, entry, shifts, 1.0 if hints is None else _WIDER)
    kept = np.flatnonzero(juts.any(axis=1))
    cells = cells.of(kept)
    at = np.where(juts[kept], shifts[kept], 0.0)
    gaps = cells.gaps(entry, at[:, None])[:, 0]
    if hints is not None:  # at the end of what is thin, the vertex would stay beside it
        beside = gaps >= _MISSED
        at[beside] = shifts[kept[beside]]
        gaps[beside] = cells.of(np.flatnonzero(beside)).gaps(entry, at[beside, None])[:, 0]
    return rows[kept], at, gaps


def _juts(cells: _Cells, entry: shapes.Entry, at: Array, wider: float) -> NDArray[np.bool_]:
    """Whether the shape falls away on both sides of `at` (k, 2), along each of the two axes (k, 2),
    `wider` times as far from it as usual:
    not at the edge of a face, where a sphere would now and then be on one side, now on the other,
    of what slides over it."""
    gaps = np.minimum(cells.gaps(entry, at[:, None] + wider * _BESIDE), _MISSED)
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


def _stand_back(
    cells: _Cells,
    entry: shapes.Entry,
    at: Array,
    loads: Array,
    flat: Array,
    *,
    turns: Array | float = 0.2,
    width: float = 0.0,
) -> Array:
    """How far (k,), in cells, the spheres at shifts `at` (k, 2) from the vertices `flat` (k, 2) m
    stand back under `loads`.

    Of what is thin, `turns` (k,) are the angles in the sheet under which it lies there, and `width`
    is half of that of the face that presses, in cells.
    """
    angles = _ANGLES + np.broadcast_to(turns, len(at))[:, None]
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    rings = np.concatenate([np.zeros((len(at), 1, 2)), *(r * circle for r in _RINGS)], axis=1)
    gaps = cells.gaps(entry, at[:, None] + rings)
    near, far = (
        np.clip(gaps[:, 1 + i * 8 : 9 + i * 8] - gaps[:, :1], -3 * r, 3 * r)
        for i, r in enumerate(_RINGS)
    )
    # without the sheet's own slope
    even = [np.maximum((rise[:, :4] + rise[:, 4:]) / 2, 0.0) for rise in (near, far)]
    own, radii = depth_beyond_mesh(loads, *profile(even[0], even[1], _RINGS), width)
    places = flat / cells.sizes[:, None]
    return np.maximum(own + depth_of_neighbours(loads, radii, places, places + at), 0.0)


def _lie(cells: _Cells, core: Array, at: Array) -> Array:
    """Angles (k,) in the sheet under which something thin lies near the shifts `at` (k, 2), by the
    points `core` (m, 3) m inside; any where it stands on end."""
    flat = cells.axes[:2]
    off = ((core @ flat.T)[None] - (cells.places @ flat.T)[:, None]) / cells.sizes[:, None, None]
    off -= at[:, None]
    near = (np.linalg.norm(off, axis=2) < WIDEST).astype(float)
    xx, yy, xy = (
        (near * off[..., i] * off[..., j]).sum(axis=1) for i, j in ((0, 0), (1, 1), (0, 1))
    )
    return np.arctan2(2 * xy, xx - yy) / 2
