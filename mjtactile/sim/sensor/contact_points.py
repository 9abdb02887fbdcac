"""Contact points that follow the object's shape within the membrane cell of each vertex.

Vertices are 2-3 mm apart. Edges, tips and small balls pass between them. At a vertex under a tip,
the membrane's finest shape is a tent of that size. The force of a cone is then 40 % too high. Near
small or sharp shapes the following corrections therefore apply.

- A vertex's sphere is placed at the point where the object protrudes farthest into the vertex's own
  cell. The search extends a little beyond the cell, so that no point falls between two cells. The
  sphere acts as the tent's top, and the force acts on the vertex.
- The sphere is shifted back by a stand-off. It is the excess of a real membrane's indentation over
  that of the mesh's tent. A force F on a disc of radius a deepens a membrane by F/(2 pi T) (ln(1/a)
  + 1/2). Here T is the tension. The mesh has its own a = 0.198 h
  (docs/theory/simulation_contact.md, C6).

`curvature_standoff.StandOff` handles round objects larger than the mesh. The vertices handle
faces.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sim.sensor import contact_cells, feature_size, ray_intersection
from mjtactile.sim.sensor.contact_cells import FOOT, HALF_WIDTH, SEARCH_DISTANCE, Cells, standoff
from mjtactile.sim.sensor.mesh import MembraneMesh, normals_of
from mjtactile.sim.sensor.sharp_geoms import KINDS, sharp_geoms
from mjtactile.sim.sensor.subgrid_indentation import depth_under_end

EVERY = 0.01
SETTLE = 0.02
"""Update period, and time constant of the stand-off, s."""
_TAKES = 0.52
"""Half width of a vertex's contact search cell, in cells, if its sphere is at home. With REACH, two
vertices would pass a ball back and forth forever."""
_SLACKEST = 0.01  # minimum strain for the tension
_STILL = 1e-5  # distance below which a sphere is back at its vertex, m
_PACE = 7.5e-3  # maximum speed of the stand-off from a thin shape, m/s: contact must not be lost
_EASE = 0.5  # fraction of a load change that is adopted per update
# radius of a sphere on a thin shape, in cells, with its top at the membrane: a membrane under
# pressure jumps by a tenth of a cell, and the shape would enter a smaller sphere and push it
# sideways
_BLUNT = 0.3
# maximum protrusion of a sphere in front of a flat end, in cells; tuned with pins of 1 and 1.5 mm
# radius
_FORWARD = 0.1
_RESTED = 0.1  # time without motion of a sharp object, s, after which its contact points stay fixed
_STAYS = 0.03  # displacement, in cells, below which a geom counts as unmoved
_HALF = 0.5  # fraction of a thin shape's half width that supports a sphere's feet


class _Goals(NamedTuple):
    """Goals of the spheres: vectors `to` (k, 3) m in S from the vertices, stand-off vectors `back`,
    flags `blunt` (k,), and `gaps` (k,), in cells, to the object."""

    to: Array
    back: Array
    blunt: NDArray[np.bool_]
    gaps: Array


class ContactPoints:
    """Positions of one sensor's contact spheres, updated every 10 ms near sharp objects."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        vertex_geom_ids: NDArray[np.int64],
        body_id: int,
        mesh: MembraneMesh,
        stiffness: float,
    ):
        """Create the contact points. `stiffness` is E h of the membrane, N/m."""
        self._model = model
        self._data = data
        self._body = body_id
        self._slackest = _SLACKEST * stiffness
        self._first = int(vertex_geom_ids[0])
        block = slice(self._first, self._first + len(vertex_geom_ids))
        # live views
        self._positions = model.geom_pos[block]
        self._radii = model.geom_size[block, 0]
        self._bounds = model.geom_rbound[block]
        self._boxes = model.geom_aabb[block, 3:]
        # otherwise MuJoCo takes the geoms' positions to be their bodies' origins
        model.geom_sameframe[vertex_geom_ids] = 0
        self._triangles = mesh.triangles
        self._interior = mesh.interior
        self._areas = mesh.areas[mesh.interior]
        self._flat = mesh.p_SV[mesh.interior, :2]
        # as stiff with eight triangles as with four
        self._sizes = np.full(len(self._areas), np.sqrt(self._areas.mean()))
        self._shapes, self._round, self._cores = sharp_geoms(
            model, body_id, mesh, float(self._sizes[0])
        )
        self._geoms = np.array(list(self._shapes), np.int64)
        self._every = EVERY
        self._eased = np.zeros(len(vertex_geom_ids))  # low-pass filtered loads, for thin shapes
        self._radius = float(model.geom_size[self._first, 0])
        self._blunt = max(_BLUNT * float(self._sizes[0]), self._radius)
        if self._shapes:
            _widen(model, model.geom_bodyid[vertex_geom_ids], self._sizes[0])
        self._back = np.zeros_like(self._positions)
        self._limits = np.full(len(self._positions), _TAKES)
        self._time = float(data.time)
        self._still = True
        self._goal = np.zeros_like(self._positions)
        self._poses: dict[int, Array] = {}
        self._since = float(data.time)
        # normals of the membrane without a nearby object: the slopes of a tent do not represent the
        # membrane
        self._upright = self._normals(mesh.p_SV)

    def update(self, p_SV: Array, tensions: Callable[[], Array], gauge_pressure: float) -> None:
        """Follow the objects near the vertices at `p_SV` (n, 3) m. `tensions` returns (n,) N/m."""
        time = float(self._data.time)
        elapsed = time - self._time
        if not self._shapes or 0 <= elapsed < self._every:
            return
        self._time = time
        self._every = EVERY
        goals = self._goals(p_SV, tensions, gauge_pressure)
        goal = goals.to
        blunt = goals.blunt
        near = bool(np.isfinite(goals.gaps).any())
        if self._cores:
            self._take(blunt, goals.gaps)
        if not near and not self._is_touched():
            self._upright = self._normals(p_SV)
            if self._still:
                return
        if not near and self._still and not self._goal.any():
            return  # all spheres are at home, and stay there
        if self._rested(time) > _RESTED:  # spheres in contact keep their position
            kept = self._touching() & ~blunt
            goal = np.where(kept[:, None], self._goal, goal)
        self._goal = goal
        self._limits = np.where(goal.any(axis=1), HALF_WIDTH, _TAKES)
        moves = min(abs(elapsed) / SETTLE, 1.0) * (goals.back - self._back)
        if self._cores:
            maximum = _PACE * abs(elapsed)
            moves = np.where(blunt[:, None], np.clip(moves, -maximum, maximum), moves)
        self._back += moves
        self._still = not near and np.abs(self._back).max() < _STILL
        if self._still:
            self._back[:] = 0.0
        self._positions[:] = goal + self._back

    def _rested(self, time: float) -> float:
        """Return the time during which no sharp object has moved relative to the sensor, s.

        Without motion, the membrane sticks to an edge or a tip. Spheres that returned to it every
        10 ms would make their vertices oscillate, and the shear by half of the normal force.
        """
        minimum = _STAYS * float(self._sizes[0])
        R_WS = self._data.xmat[self._body].reshape(3, 3)
        poses = {geom: self._pose(geom, R_WS) for geom in self._shapes}
        change = (
            np.abs(pose - self._poses.get(geom, np.inf)).max() for geom, pose in poses.items()
        )
        if max(change, default=0.0) < minimum:
            return max(time - self._since, 0.0)
        self._poses = poses
        self._since = time
        return 0.0

    def _pose(self, geom: int, R_WS: Array) -> Array:
        """Return position (3,) m and axes of a geom in S as columns (3, 4), scaled by its
        radius."""
        axes = R_WS.T @ self._data.geom_xmat[geom].reshape(3, 3)
        position = self._in_sensor(self._data.geom_xpos[geom])
        return np.column_stack([position, self._model.geom_rbound[geom] * axes])

    def _touching(self) -> NDArray[np.bool_]:
        """Return a mask (k,) of the vertices in contact."""
        touching = np.zeros(len(self._sizes), dtype=bool)
        vertices, is_own = self._contact_vertices()
        touching[vertices[is_own]] = True
        return touching

    def _contact_vertices(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return vertex indices (n, 2) of MuJoCo's contacts, and a mask of those of this sensor."""
        vertices = self._data.contact.geom - self._first
        return vertices, (vertices >= 0) & (vertices < len(self._sizes))

    def _goals(self, p_SV: Array, tensions: Callable[[], Array], gauge_pressure: float) -> _Goals:
        """Return the goals of the spheres of vertices at `p_SV` (n, 3) m."""
        count = len(self._positions)
        to, back = np.zeros((2, count, 3))
        goals = _Goals(to, back, np.zeros(count, dtype=bool), np.full(count, np.inf))
        loads = None
        vertices = p_SV[self._interior]
        for geom in self._close_geoms(vertices):
            entry = self._shapes[geom]
            close = self._close_to(geom, vertices)
            if not len(close):
                continue
            normal = self._upright[close].sum(axis=0)
            axes = contact_cells.axes_of(normal / np.linalg.norm(normal))
            cells = self._cells_in_geom(geom, vertices[close], axes, self._sizes[close])
            if geom in self._round:  # except for its ends
                at_end = self._rows_at_end(geom, cells)
                close = close[at_end]
                cells = cells.of(at_end)
            is_thin = geom in self._cores
            hints = self._hints(geom, entry, cells) if is_thin else None
            foot = self._foot(geom) if is_thin else FOOT
            rows, at, gaps = contact_cells.deepest(cells, entry, self._limits[close], foot, hints)
            better = gaps < goals.gaps[close[rows]]
            rows = rows[better]
            at = at[better]
            touching = close[rows]
            goals.gaps[touching] = gaps[better]
            goals.to[touching] = self._sizes[touching, None] * (at @ axes[:2])
            goals.back[touching] = 0.0
            goals.blunt[touching] = is_thin
            if is_thin:
                goals.to[touching] -= (self._blunt - self._radius) * axes[2]
            if len(rows) and int(self._model.geom_type[geom]) in KINDS:
                if loads is None:
                    loads = self._loads(tensions, gauge_pressure)
                    self._ease(loads)
                bearing = self._eased if is_thin else loads
                pressed = bearing[touching] > 0
                rows = rows[pressed]
                at = at[pressed]
                touching = touching[pressed]
                back = self._stand_back(geom, entry, cells.of(rows), at, bearing, touching)
                goals.back[touching] = -(self._sizes[touching] * back)[:, None] * axes[2]
        return goals

    def _close_geoms(self, vertices: Array) -> list[int]:
        """Return the geoms that may be close to one of the `vertices` (k, 3) m in S, by one
        ball."""
        data = self._data
        center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        radius = float(np.linalg.norm(np.ptp(vertices, axis=0))) / 2
        size = float(self._sizes[0])
        positions = self._in_sensor(data.geom_xpos[self._geoms])
        distance = np.linalg.norm(positions - center, axis=1) - self._model.geom_rbound[self._geoms]
        found = self._geoms[distance < radius + size].tolist()
        if not found:
            return found
        p_W = data.xpos[self._body] + data.xmat[self._body].reshape(3, 3) @ center
        extent = radius + 2 * size  # as `_is_far` has it
        return [
            geom
            for geom in found
            if feature_size.box_distances(self._model, data, geom, p_W[None])[0] <= extent
        ]

    def _close_to(self, geom: int, vertices: Array) -> NDArray[np.int64]:
        """Return the indices of the `vertices` (k, 3) m in S that a geom may be near."""
        center = self._in_sensor(self._data.geom_xpos[geom])
        distances = np.linalg.norm(vertices - center, axis=1)
        close = np.flatnonzero(distances - self._model.geom_rbound[geom] < self._sizes)
        if len(close) and self._is_far(geom, vertices[close]):
            return close[:0]
        return close

    def _rows_at_end(self, geom: int, cells: Cells) -> NDArray[np.int64]:
        """Return the rows of the cells at an end of a cylinder, or beyond it."""
        extent = np.abs(cells.positions[:, 2]) + 2 * cells.sizes
        return np.flatnonzero(extent > self._model.geom_size[geom, 1])

    def _hints(self, geom: int, entry: ray_intersection.Entry, cells: Cells) -> tuple[Array, Array]:
        """Return shifts and gaps to the points where a thin geom reaches farthest in."""
        hints = contact_cells.initial_offsets(cells, entry, self._cores[geom])
        if hints[1].min(initial=np.inf) < SEARCH_DISTANCE:
            # it is met from the first step
            self._every = EVERY if self._is_touched() else 0.0
        return hints

    def _foot(self, geom: int) -> Array:
        """Return the points of a sphere that must rest on a thin geom, in cells."""
        thin = feature_size.feature_radius(self._model, geom) / self._sizes[0]
        return min(1.0, _HALF * thin / np.abs(FOOT).max()) * FOOT

    def _stand_back(
        self,
        geom: int,
        entry: ray_intersection.Entry,
        cells: Cells,
        at: Array,
        loads: Array,
        touching: NDArray[np.int64],
    ) -> Array:
        """Return the stand-off (k,), in cells, of spheres at shifts `at` (k, 2) from `touching`
        (k,)."""
        flat = self._flat[touching]
        loads = loads[touching]
        if geom not in self._cores:
            return standoff(cells, entry, at, loads, flat)
        size = self._sizes[0]
        end = self._end(geom, cells.axes[2]) / size
        if end:
            return np.maximum(depth_under_end(loads, end, flat / size), -_FORWARD)
        turns = contact_cells.angles_of(cells, self._cores[geom], at)
        width = self._width(geom) / size
        return standoff(cells, entry, at, loads, flat, turns=turns, width=width)

    def _take(self, blunt: NDArray[np.bool_], gaps: Array) -> None:
        """Make the spheres of these vertices `blunt`, and the others small again.

        An object already inside a vertex's cell is met at its present position, and lifted later.
        """
        sunk = blunt & (self._radii == self._radius) & (gaps < 0)
        self._back[sunk] = 0.0
        self._back[sunk, 2] = self._sizes[sunk] * gaps[sunk]
        radii = np.where(blunt, self._blunt, self._radius)
        self._radii[:] = radii
        self._bounds[:] = radii
        self._boxes[:] = radii[:, None]

    def _ease(self, loads: Array) -> None:
        """Follow `loads` (k,) slowly: a contact lost for one step returns with the same
        stand-off."""
        self._eased += _EASE * (np.maximum(loads, 0.0) - self._eased)

    def _is_touched(self) -> bool:
        return bool(self._contact_vertices()[1].any())

    def _width(self, geom: int) -> float:
        """Return the half width of the flat edge of a blade, m; 0 for a round geom."""
        if int(self._model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_BOX):
            return feature_size.feature_radius(self._model, geom)
        return 0.0

    def _end(self, geom: int, outward: Array) -> float:
        """Return the radius of a pin's flat end, m, if it touches with it along `outward`;
        otherwise 0."""
        on_end = abs(float(outward[2])) > feature_size.END
        if on_end and int(self._model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_CYLINDER):
            return float(self._model.geom_size[geom, 0])
        return 0.0

    def _is_far(self, geom: int, vertices: Array) -> bool:
        """Return True if the box around a geom is two cells away."""
        data = self._data
        p_WV = data.xpos[self._body] + vertices @ data.xmat[self._body].reshape(3, 3).T
        away = feature_size.box_distances(self._model, data, geom, p_WV)
        return bool(away.min() > 2 * self._sizes[0])

    def _in_sensor(self, p_W: Array) -> Array:
        data = self._data
        return (p_W - data.xpos[self._body]) @ data.xmat[self._body].reshape(3, 3)

    def _cells_in_geom(self, geom: int, vertices: Array, axes: Array, sizes: Array) -> Cells:
        """Return the cells around `vertices` (k, 3) m in S, in the frame of the geom."""
        data = self._data
        R_WS = data.xmat[self._body].reshape(3, 3)
        R_WG = data.geom_xmat[geom].reshape(3, 3)
        rotation = R_WS.T @ R_WG  # rows are vectors
        shift = (data.xpos[self._body] - data.geom_xpos[geom]) @ R_WG
        return Cells(vertices @ rotation + shift, axes @ rotation, sizes)

    def _normals(self, p_SV: Array) -> Array:
        """Return the outward unit normals (k, 3) of the membrane at the vertices."""
        return normals_of(p_SV, self._triangles)[self._interior]

    def _loads(self, tensions: Callable[[], Array], gauge_pressure: float) -> Array:
        """Return the contact forces (k,) beyond the gas load, over 2 pi times tension and cell
        size."""
        contact = self._data.contact
        vertex_ids, mine = self._contact_vertices()
        rows = np.flatnonzero(mine.any(axis=1) & (contact.efc_address >= 0))
        vertices = np.where(mine[rows, 1], vertex_ids[rows, 1], vertex_ids[rows, 0])
        forces = (
            np.bincount(vertices, self._data.efc_force[contact.efc_address[rows]], len(self._sizes))
            if len(rows)
            else 0.0
        )
        tension = np.maximum(tensions()[self._interior], self._slackest)
        return (forces - gauge_pressure * self._areas) / (2 * np.pi * tension * self._sizes)


def _widen(model: mujoco.MjModel, bodies: NDArray[np.int64], size: float) -> None:
    """Extend MuJoCo's contact search of each vertex to the maximum shift of its sphere."""
    for body in bodies:
        first = int(model.body_bvhadr[body])
        model.bvh_aabb[first : first + model.body_bvhnum[body], 3:] = size
