"""Periodic checks of a running scene.

They detect penetration and tunneling through a membrane, geoms too small or sharp for its mesh, and
objects too fast for the step.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import geometry
from mjtactile.core.flags import SIMULATION, Cadence, Reasons
from mjtactile.core.types import Array
from mjtactile.sim.sensor import contact_loads, feature_size, validity_checks
from mjtactile.sim.sensor.collision_rule import pair_only_geoms
from mjtactile.sim.sensor.feature_flags import FeatureFlags
from mjtactile.sim.sensor.force_flags import ForceFlags
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor
from mjtactile.sim.sensor.sensor_types import AnySensor
from mjtactile.sim.sensor.tunneling_check import CorePoints

PENETRATION = 0.05  # maximum ratio of penetration to indentation
_SUNK = 0.5  # ratio of penetration to indentation at which forces are meaningless
_FAST = 0.5  # maximum motion in a step, relative to the geom's size
_NEAR = 0.05  # distance from the membrane's center, m
_MIN_INDENTATION = 3e-4  # minimum indentation, m, for meaningful ratios to it
_QS_RARE_PERIOD = 20  # period in checks, which are 0.1 s apart
# period in checks: stretch and wrinkles change no faster than pressure; speed is also checked in
# every step
_RARELY = 5


class SceneMonitor:
    """Periodic monitor of a running world."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, sensors: tuple[AnySensor, ...]):
        self._model = model
        self._data = data
        self._sensors = sensors
        touching = [
            # those with contacts by <pair> only go through the membrane, which stops the run
            np.union1d(
                feature_size.touching_geoms(model, sensor.body_id),
                pair_only_geoms(model, sensor.body_id),
            )
            for sensor in sensors
        ]
        self._geoms = np.unique(np.concatenate([np.empty(0, int), *touching]))
        self._can_touch = [np.isin(self._geoms, own) for own in touching]
        """Masks over `_geoms`, one per sensor, of the geoms that the sensor can touch."""
        self._sizes = np.array([feature_size.feature_radius(model, int(g)) for g in self._geoms])
        self._geoms_of = [self._geoms[own] for own in self._can_touch]
        self._thin = [
            self._geoms[own & (self._sizes < feature_size.RESOLVED * sensor.mesh.spacing)]
            for own, sensor in zip(self._can_touch, sensors, strict=True)
        ]
        self._any_thin = any(map(len, self._thin))
        is_quasistatic = [isinstance(one, QuasistaticSensor) for one in sensors]
        self.only_quasistatic = bool(sensors) and all(is_quasistatic)
        self._cores = [
            CorePoints(model, self._geoms[own], sensor.mesh, sensor.contact)
            for own, sensor in zip(self._can_touch, sensors, strict=True)
        ]
        mujoco.mj_kinematics(model, data)  # a new state has no positions yet
        for core, sensor in zip(self._cores, sensors, strict=True):
            core.forget(data, sensor.body_id, sensor.p_SV, sensor.design.chamber.depth)
        own = np.concatenate([np.empty(0, int), *(s.dofs for s in sensors)])
        self._movers = np.setdiff1d(np.arange(model.nv), own)
        minimum = _FAST * self._sizes.min(initial=np.inf) / float(model.opt.timestep)
        self._max_speeds = minimum / np.maximum(model.dof_length[self._movers], 1e-9)
        self._reference_heights = [sensor.heights for sensor in sensors]
        self._deep = np.zeros((len(sensors), 5))  # ratios at the last checks
        self._forces = ForceFlags(model, data, sensors)
        self._features = FeatureFlags(model, data, self._geoms, self._sizes)
        self._check_count = -1
        self._positions = self._geoms_in(sensors)

    @property
    def needs_every_step(self) -> bool:
        """True if a geom is so thin that every step must be checked."""
        return self._any_thin and not self.only_quasistatic

    @property
    def speeds(self) -> tuple[NDArray[np.int64], Array]:
        """Degrees of freedom (n,) outside the sensors, with speed limits (n,)."""
        return self._movers, self._max_speeds

    @property
    def contact_counts(self) -> tuple[int, int]:
        """Numbers of geoms near the membranes and of contact points on them."""
        near = [
            contact_loads.near_geoms(self._model, self._data, sensor, geoms)
            for sensor, geoms in zip(self._sensors, self._geoms_of, strict=True)
        ]
        points = contact_loads.contact_points(self._data, self._sensors)
        return len(np.unique(np.concatenate(near))), points

    def initial_flags(self) -> Reasons:
        """Return the flags of the scene as built."""
        flags: Reasons = {}
        for sensor in self._sensors:
            flags |= validity_checks.design_flags(sensor.design, sensor.mesh.nx, sensor.mesh.ny)
            if isinstance(sensor, QuasistaticSensor) or sensor.contact != "vertices":
                continue
            radius, name = sensor.missed
            if np.isfinite(radius):
                flags["small_feature"] = (
                    f"{name!r} (radius {radius * 1e3:.2g} mm) can slip between the membrane's "
                    "vertices, its only contact points; use contact 'auto' or 'elements'"
                )
        return flags

    def check(self) -> tuple[Reasons, Collection[Cadence], str | None]:
        """Return flags of the present state, the checked cadences, and a reason to stop or None."""
        flags: Reasons = {}
        stop = None
        if all(sensor.is_asleep for sensor in self._sensors):
            return flags, SIMULATION, stop
        self._check_count += 1
        # quasi-static membranes detect tunneling themselves
        if self.only_quasistatic and self._check_count % _QS_RARE_PERIOD:
            for index, sensor in enumerate(self._sensors):
                flags |= self._forces.frame(index) | self._contact_flags(sensor)
            return flags, {Cadence.FAST}, stop
        positions = self._geoms_in(self._sensors)
        is_slow_check = self._check_count % _RARELY == 0
        for index, sensor in enumerate(self._sensors):
            if sensor.is_asleep:
                continue
            flags |= sensor.flags() if is_slow_check else self._contact_flags(sensor)
            rows = contact_loads.on_membrane(self._data, sensor)[0]
            rows = rows[self._data.contact.exclude[rows] == 0]  # 1: near, but not touching
            flags |= self._forces.frame(index) | self._forces.chatter(index)
            flags |= self._features.touching(sensor, rows) if len(rows) else {}
            lasting = self._penetration(index, rows)
            if lasting > PENETRATION:
                flags["penetration"] = (
                    f"objects penetrate the membrane by {lasting:.0%} of the indentation, "
                    f"more than {PENETRATION:.0%}; a smaller timestep makes contact stiffer"
                )
            if lasting > _SUNK:
                stop = f"sensor {sensor.prefix!r}: {flags['penetration']}"
            jumped = self._jumped(index, positions[index])
            if jumped and isinstance(sensor, QuasistaticSensor):
                flags["quasistatic"] = jumped
            else:
                stop = stop or jumped
        self._positions = positions
        stop = stop or self.tunneled_geom()
        if not is_slow_check:
            return flags, SIMULATION - {Cadence.SLOW}, stop
        return flags | self._too_fast(positions), SIMULATION, stop

    @staticmethod
    def _contact_flags(sensor: AnySensor) -> Reasons:
        return sensor.contact_flags() if isinstance(sensor, QuasistaticSensor) else {}

    def _penetration(self, index: int, rows: NDArray[np.int64]) -> float:
        """Return the penetration over the indentation that lasts for several checks."""
        heights = self._sensors[index].heights
        if not len(rows):
            self._reference_heights[index] = heights
            self._deep[index] = 0.0
            return 0.0
        indentation = max(float((self._reference_heights[index] - heights).max()), 0.0)
        depth = max(float(self._sensors[index].penetrations(rows).max()), 0.0)
        self._deep[index] = [
            *self._deep[index, 1:],
            depth / max(indentation + depth, _MIN_INDENTATION),
        ]
        return float(self._deep[index].min())

    def _geoms_in(self, sensors: tuple[AnySensor, ...]) -> list[Array]:
        """Return the centers (g, 3) m of the geoms that can touch, in each sensor's frame."""
        data = self._data
        return [
            (data.geom_xpos[self._geoms] - data.xpos[s.body_id])
            @ data.xmat[s.body_id].reshape(3, 3)
            for s in sensors
        ]

    def tunneled_geom(self, every: bool = True) -> str | None:
        """Return a message for the first geom that passed through a mesh, or None.

        Without `every`, only geoms thin enough to pass within one step are checked.
        """
        if not every and not self.needs_every_step:
            return None
        for index, sensor in enumerate(self._sensors):
            if sensor.is_asleep or isinstance(sensor, QuasistaticSensor):
                continue
            p_SV = None
            for geom in self._geoms_over(
                sensor, self._geoms_of[index] if every else self._thin[index]
            ):
                p_SV = sensor.p_SV if p_SV is None else p_SV
                if self._cores[index].behind(
                    self._data, sensor.body_id, p_SV, int(geom), sensor.design.chamber.depth
                ):
                    return self._went_through(sensor, int(geom))
        return None

    def _geoms_over(self, sensor: AnySensor, geoms: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the `geoms` whose bounding spheres reach into the sensor's opening, or behind
        it."""
        if not len(geoms):
            return geoms
        data = self._data
        frame = sensor.design.frame
        R_WS = data.xmat[sensor.body_id].reshape(3, 3)
        positions = (data.geom_xpos[geoms] - data.xpos[sensor.body_id]) @ R_WS
        radii = self._model.geom_rbound[geoms]
        depth = sensor.design.chamber.depth
        top = max(float(sensor.heights.max()), 0.0)
        return geoms[
            (np.abs(positions[:, 0]) < frame.length / 2 + radii)
            & (np.abs(positions[:, 1]) < frame.width / 2 + radii)
            & (positions[:, 2] < top + radii)
            & (positions[:, 2] > -depth - radii)
        ]

    def _jumped(self, index: int, positions: Array) -> str | None:
        """Return a message if a geom was in front of the membrane and is now behind the glass."""
        sensor = self._sensors[index]
        frame = sensor.design.frame
        glass = -sensor.design.chamber.depth
        top = max(float(sensor.heights.max()), 0.0)
        jumped = (
            (self._positions[index][:, 2] > top)
            & (positions[:, 2] < glass)
            & self._can_touch[index]
        )
        over = np.abs(positions[:, :2]) < (0.45 * frame.length, 0.45 * frame.width)
        for k in np.flatnonzero(jumped & over.all(axis=1)):
            return self._went_through(sensor, int(self._geoms[k]))
        return None

    def _went_through(self, sensor: AnySensor, geom: int) -> str:
        name = feature_size.name_of(self._model, geom)
        return (
            f"sensor {sensor.prefix!r}: {name!r} went through the membrane; use a smaller "
            "timestep or finer mesh"
        )

    def speed_flags(self) -> Reasons:
        """Return the flag of an object that is too fast, checked at every step."""
        hurries = (np.abs(self._data.qvel[self._movers]) > self._max_speeds).any()
        return self._too_fast(self._geoms_in(self._sensors)) if hurries else {}

    def _too_fast(self, positions: Sequence[Array]) -> Reasons:
        """Return a flag for objects near a membrane that move by half their size per step."""
        flags: Reasons = {}
        if not len(self._geoms):
            return flags
        velocities = self._velocities(self._model.geom_bodyid[self._geoms])
        step = float(self._model.opt.timestep)
        for sensor, position, touching in zip(
            self._sensors, positions, self._can_touch, strict=True
        ):
            velocity = velocities - self._velocities([sensor.body_id])
            speed = np.sqrt(np.einsum("ki,ki->k", velocity, velocity))
            near = np.einsum("ki,ki->k", position, position) < (_NEAR + self._sizes) ** 2
            fraction = speed * (near & touching) * step / self._sizes
            k = int(np.argmax(fraction))
            if fraction[k] > _FAST:
                best = _FAST / 2 * self._sizes[k] / speed[k] * 1e3
                flags["speed"] = (
                    f"an object approaches at {speed[k]:.2g} m/s, more than half its size per "
                    f"step; use a timestep of at most {best:.2g} ms"
                )
        return flags

    def _velocities(self, bodies: Sequence[int] | np.ndarray) -> Array:
        """Return the velocities (n, 3) m/s of the origins of MuJoCo bodies, frame W."""
        data = self._data
        root = self._model.body_rootid[bodies]
        angular_velocity = data.cvel[bodies, :3]
        arm = data.xpos[bodies] - data.subtree_com[root]
        return data.cvel[bodies, 3:] + geometry.cross(angular_velocity, arm)
