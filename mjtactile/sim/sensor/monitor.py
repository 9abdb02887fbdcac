"""What is looked at now and then in a running scene: penetration, things that went through a
membrane, things too small or sharp for its mesh, objects too fast for the step."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import geometry
from mjtactile.core.types import Array
from mjtactile.sim.sensor import features, limits, loads
from mjtactile.sim.sensor.any import AnySensor
from mjtactile.sim.sensor.limits import Flags

PENETRATION = 0.05  # share of the indentation
_SUNK = 0.5  # share of the indentation at which a force means nothing
_FAST = 0.5  # of its own size in a step
_FRAMED = 0.2  # N on the frame for five looks
_NEAR = 0.05  # m from the membrane's middle
_LEAST_INDENTATION = 3e-4  # m; below it, shares of the indentation say nothing
# looks: stretch and wrinkles come and go no faster than pressure does; speed is watched in every
# step, too
_RARELY = 5


class SceneMonitor:
    """Looks at a running world now and then: penetration, things that went through, objects too
    fast for the step."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, sensors: tuple[AnySensor, ...]):
        self._model = model
        self._data = data
        self._sensors = sensors
        felt = [features.touching_geoms(model, sensor.body_id) for sensor in sensors]
        self._geoms = np.unique(np.concatenate([np.empty(0, int), *felt]))
        self._felt = [np.isin(self._geoms, own) for own in felt]
        """Which of `_geoms` each sensor can feel."""
        self._sizes = np.array([features.feature_radius(model, int(g)) for g in self._geoms])
        self._index = np.full(model.ngeom + 1, -1)  # of geom ids, and of -1
        self._index[self._geoms] = np.arange(len(self._geoms))
        self._faces, self._sides = (
            np.array([features.edge_half_width(model, int(g), axial) for g in self._geoms])
            for axial in (1.0, 0.0)
        )
        self._has_edges = np.isfinite(np.minimum(self._faces, self._sides)).tolist()
        self._movers = np.setdiff1d(
            np.arange(model.nv), np.concatenate([np.empty(0, int), *(s.dofs for s in sensors)])
        )
        least = _FAST * self._sizes.min(initial=np.inf) / float(model.opt.timestep)
        self._hurry = least / np.maximum(model.dof_length[self._movers], 1e-9)
        self._rest = [sensor.heights for sensor in sensors]
        self._deep = np.zeros((len(sensors), 5))  # shares at the last looks
        self._framed = np.zeros((len(sensors), 5))  # N at the last looks
        self._most_framed = np.zeros(len(sensors))  # N that lasted
        self._looks = -1
        self._places = self._geoms_in(sensors)
        self._hulls: dict[int, str | None] = {}  # of those of `_geoms` that have touched

    def built(self) -> Flags:
        """Flags of the scene as it was built."""
        flags: Flags = {}
        for sensor in self._sensors:
            flags |= limits.design_flags(sensor.design, sensor.mesh.nx, sensor.mesh.ny)
        return flags

    def look(self) -> tuple[Flags, str | None]:
        """Flags of the present state, and the reason to stop, if there is one. Call every 20 ms or
        so."""
        flags: Flags = {}
        stop = None
        if all(sensor.is_asleep for sensor in self._sensors):
            return flags, stop
        places = self._geoms_in(self._sensors)
        self._looks += 1
        for number, sensor in enumerate(self._sensors):
            if sensor.is_asleep:
                continue
            if self._looks % _RARELY == 0:
                flags |= sensor.flags()
            rows = loads.on_membrane(self._data, sensor)[0]
            rows = rows[self._data.contact.exclude[rows] == 0]  # 1: near, but not touching
            flags |= self._frame(number)
            flags |= self._shapes(sensor, rows) if len(rows) else {}
            lasting = self._penetration(number, rows)
            if lasting > PENETRATION:
                flags["penetration"] = (
                    f"objects sink into the membrane by {lasting:.0%} of what they push in, more "
                    f"than {PENETRATION:.0%}; a smaller timestep makes contact stiffer"
                )
            if lasting > _SUNK:
                stop = f"sensor {sensor.prefix!r}: {flags['penetration']}"
            stop = stop or self._passed(number, places[number])
        self._places = places
        if self._looks % _RARELY == 0:
            flags |= self._too_fast(places)
        return flags, stop

    def _shapes(self, sensor: AnySensor, rows: NDArray[np.int64]) -> Flags:
        """What is to be said of the geoms that touch in the contacts `rows`: too small for the
        mesh, edges, hollows."""
        flags: Flags = {}
        contact = self._data.contact
        others = self._index[contact.geom[rows]].max(axis=1)  # -1: not one of `_geoms`
        touching = set(others.tolist()) - {-1}
        if not touching:
            return flags
        smallest = min(touching, key=lambda k: self._sizes[k])
        feature = features.resolution_flag(
            self._model, int(self._geoms[smallest]), float(self._sizes[smallest]), sensor.mesh
        )
        if feature:
            flags["feature"] = feature
        if any(self._has_edges[k] for k in touching):
            edge = features.edge_flag(
                self._nearest_edge(rows[others >= 0], others[others >= 0]), sensor.mesh
            )
            flags |= {"edge": edge} if edge else {}
        for k in touching:
            if k not in self._hulls:
                self._hulls[k] = features.hull_flag(self._model, int(self._geoms[k]))
            if hull := self._hulls[k]:
                flags["hull"] = hull
        return flags

    def _nearest_edge(self, rows: NDArray[np.int64], others: NDArray[np.int64]) -> float:
        """Least half width, m, of the faces with edges that touch in the contacts `rows`, of the
        geoms `others` in `_geoms`."""
        axes = self._data.geom_xmat[self._geoms[others]].reshape(-1, 3, 3)[:, :, 2]
        axial = np.abs(np.einsum("ki,ki->k", self._data.contact.frame[rows, :3], axes))
        return float(np.where(axial > features.END, self._faces[others], self._sides[others]).min())

    def _penetration(self, number: int, rows: NDArray[np.int64]) -> float:
        """Penetration as a share of the indentation, if it lasts for some looks: an impact sinks in
        for a moment."""
        heights = self._sensors[number].heights
        if not len(rows):
            self._rest[number] = heights
            self._deep[number] = 0.0
            return 0.0
        indentation = max(float((self._rest[number] - heights).max()), 0.0)
        depth = max(float(self._sensors[number].penetrations(rows).max()), 0.0)
        self._deep[number] = [
            *self._deep[number, 1:],
            depth / max(indentation + depth, _LEAST_INDENTATION),
        ]
        return float(self._deep[number].min())

    def _frame(self, number: int) -> Flags:
        """Say when the frame of a sensor carries force for some looks, which its camera cannot
        see."""
        load = loads.frame_load(self._data, self._sensors[number])
        self._framed[number] = [*self._framed[number, 1:], load]
        lasting = float(self._framed[number].min())
        most = self._most_framed.max()
        if lasting < _FRAMED or lasting <= most:
            return {}
        self._most_framed[number] = lasting
        return {
            "frame": f"the frame of sensor {self._sensors[number].prefix!r} carries {lasting:.1f} "
            "N, which touch does not tell: the camera sees the membrane alone"
        }

    def _geoms_in(self, sensors: tuple[AnySensor, ...]) -> list[Array]:
        """Centres (g, 3) m of what may touch, in each sensor's frame."""
        data = self._data
        return [
            (data.geom_xpos[self._geoms] - data.xpos[s.body_id])
            @ data.xmat[s.body_id].reshape(3, 3)
            for s in sensors
        ]

    def _passed(self, number: int, places: Array) -> str | None:
        """Something whose middle is behind the membrane, or was before it and is now behind the
        glass, went through it."""
        sensor = self._sensors[number]
        frame = sensor.design.frame
        before = self._places[number]
        top = max(float(sensor.heights.max()), 0.0)
        glass = -sensor.design.chamber.depth
        low = np.flatnonzero((places[:, 2] < top) & self._felt[number])
        if not len(low):
            return None
        p_SV = sensor.p_SV
        for k in low[
            (np.abs(places[low, :2]) < (0.45 * frame.length, 0.45 * frame.width)).all(axis=1)
        ]:
            nearest = np.argmin(((p_SV[:, :2] - places[k, :2]) ** 2).sum(axis=1))
            if (places[k, 2] < p_SV[nearest, 2]) if places[k, 2] > glass else (before[k, 2] > top):
                name = self._model.geom(int(self._geoms[k])).name or f"geom {self._geoms[k]}"
                return (
                    f"sensor {sensor.prefix!r}: {name!r} went through the membrane; use a "
                    "smaller timestep or finer mesh"
                )
        return None

    def hurried(self) -> Flags:
        """The flag of something too fast, which a look now and then could miss; cheap while nothing
        is, for every step."""
        hurries = (np.abs(self._data.qvel[self._movers]) > self._hurry).any()
        return self._too_fast(self._geoms_in(self._sensors)) if hurries else {}

    def _too_fast(self, places: Sequence[Array]) -> Flags:
        """Objects near a membrane that move by more than half their size in a step may not be seen
        in time."""
        flags: Flags = {}
        if not len(self._geoms):
            return flags
        velocities = self._velocities(self._model.geom_bodyid[self._geoms])
        step = float(self._model.opt.timestep)
        for sensor, place, felt in zip(self._sensors, places, self._felt, strict=True):
            velocity = velocities - self._velocities([sensor.body_id])
            speed = np.sqrt(np.einsum("ki,ki->k", velocity, velocity))
            near = np.einsum("ki,ki->k", place, place) < (_NEAR + self._sizes) ** 2
            share = speed * (near & felt) * step / self._sizes
            k = int(np.argmax(share))
            if share[k] > _FAST:
                best = _FAST / 2 * self._sizes[k] / speed[k] * 1e3
                flags["speed"] = (
                    f"an object approaches at {speed[k]:.2g} m/s, more than half its size in a "
                    f"step; use a timestep of at most {best:.2g} ms"
                )
        return flags

    def _velocities(self, bodies: Sequence[int] | np.ndarray) -> Array:
        """Velocities (n, 3) m/s of the origins of bodies, frame W."""
        data = self._data
        root = self._model.body_rootid[bodies]
        turn = data.cvel[bodies, :3]
        arm = data.xpos[bodies] - data.subtree_com[root]
        return data.cvel[bodies, 3:] + geometry.cross(turn, arm)
