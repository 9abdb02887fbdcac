"""Disturbances of a held object in a task: filling, wetting, shaking, pushing, pulling, moved
support.

A shaken or rotated gripper is simulated by shaken and rotated gravity, which is the same in the
gripper's own frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.gripper_path import GripperPath
from mjtactile.core.task import SampledDisturbance
from mjtactile.core.types import Array
from mjtactile.sim.scenes.initial_state import path_axes
from mjtactile.sim.scenes.objects import PLACE_PREFIX, PREFIX, moving_bodies

if TYPE_CHECKING:
    from mjtactile.sim.scenes.grasp_world import GraspWorld

UP = 0.9
"""Fraction of the commanded lift height at which the gripper counts as lifted."""
_PREFIXES = (PREFIX, PLACE_PREFIX, "table/")
TAKEN_TIME = 0.02  # time to stop an object taken by a person, s: within 8 mm at 0.4 m/s
_HOLDS = 2  # minimum number of fingers of a grip; contact with a single finger does not hold
_FASTER = 2.0  # upper bound of the rising speed, as a multiple of the lift speed
_RAMP_PERIOD = 0.01  # update period of mass and friction, s
_RAMPS = ("fill", "friction")
ROTATION_MAX = math.radians(60)


class DisturbanceSchedule:
    """Disturbances of one grasp.

    `step`, called after each batch of world steps, prepares the next one, which ends when the
    schedule is `due` again. During a disturbance that is after each step.
    """

    def __init__(
        self,
        world: GraspWorld,
        events: Sequence[SampledDisturbance],
        lift_height: float,
        path: GripperPath | None = None,
    ):
        model = world.model
        self._world = world
        self._events = [_in_world(event, path_axes(world.start)) for event in events]
        self._path = path
        self._up = UP * lift_height
        self._bodies = moving_bodies(model, PREFIX)
        self._fraction = model.body_mass[self._bodies] / model.body_mass[self._bodies].sum()
        self._lift_speed = world.rig.lift.speed
        self._start_height = float(world.data.xpos[world.start.gripper, 2])
        self._gravity = model.opt.gravity.copy()
        self._mass = model.body_mass[self._bodies].copy()
        self._inertia = model.body_inertia[self._bodies].copy()
        owners = np.isin(model.geom_bodyid, self._bodies)
        self._surfaces = np.flatnonzero(owners)
        self._surface_friction = model.geom_friction[self._surfaces, 0].copy()
        self._frictions = [sensor.friction for sensor in world.sensors]
        self._supports = static_bodies(model)
        self._support_height = model.body_pos[self._supports, 2].copy()
        self._first_mass = float(self._mass.sum())
        self._second = world.second_object
        self.up_since = math.nan
        """Time when the lift was completed, s; NaN: not yet lifted."""
        self.is_taken = False
        """True once the object was pulled out of the gripper or handed over."""

    def step(self) -> None:
        """Set masses, gravity, forces and positions for the world's next step."""
        world = self._world
        if math.isnan(self.up_since):
            if self._risen() < self._up:
                return
            self.up_since = world.time
        time = world.time - self.up_since
        self._wet(time)
        if self._path is not None and time > 0:
            world.displace(self._path.at(time))
        done = [min(max((time - event.start) / event.duration, 0.0), 1.0) for event in self._events]
        started = [pair for pair in zip(self._events, done, strict=True) if pair[1] > 0]
        self._change(started)
        force = np.zeros(3)
        gravity = self._gravity.copy()
        for event, fraction in started:
            is_on = fraction < 1.0
            if event.kind == "shake" and is_on:
                gravity = _shaken(gravity, event, time - event.start, fraction)
            elif event.kind == "push" and is_on:
                force += np.array(event.direction) * event.values["impulse"] / event.duration
            elif event.kind == "pull":
                force += self._pull(event, fraction)
        world.model.opt.gravity[:] = gravity
        world.data.xfrc_applied[self._bodies, :3] = self._fraction[:, None] * force

    def _change(self, started: Sequence[tuple[SampledDisturbance, float]]) -> None:
        """Set masses and positions by the fractions of the events that have passed."""
        for event, done in started:
            if event.kind == "fill":
                self._fill(event.values["mass"], done)
            elif event.kind == "move_support":
                height = event.values["height"] * done
                self._world.model.body_pos[self._supports, 2] = self._support_height + height
            elif event.kind == "stack" and self._second is not None:
                self._second.put(done)

    def due(self) -> float:
        """Return the latest world time of the next call of `step`, s."""
        world = self._world
        if math.isnan(self.up_since):
            missing = self._up - self._risen()
            return world.time + missing / (_FASTER * self._lift_speed)
        time = world.time - self.up_since
        due = math.inf
        for event in self._events:
            goes_on = event.kind == "pull" or time < event.start + event.duration + world.timestep
            if goes_on:
                waits = _RAMP_PERIOD if event.kind in _RAMPS else 0.0
                due = min(due, max(event.start, time + waits))
        if self._path is not None:
            due = min(due, max(self._path.next_start(time - world.timestep), time))
        return self.up_since + due

    def _risen(self) -> float:
        """Return the height of the gripper above its start, m."""
        return float(self._world.data.xpos[self._world.start.gripper, 2]) - self._start_height

    def _fill(self, mass: float, done: float) -> None:
        """Scale masses and inertias of the object towards a total of `mass` kg."""
        model = self._world.model
        ratio = 1 + (mass / self._first_mass - 1) * done
        added = ratio * self._mass - model.body_mass[self._bodies]
        model.body_mass[self._bodies] += added
        model.body_inertia[self._bodies] = ratio * self._inertia
        # each is a tree of its own, in the world's
        model.body_subtreemass[self._bodies] += added
        model.body_subtreemass[0] += added.sum()

    def _wet(self, time: float) -> None:
        """Set the friction coefficient of each membrane with the object, `time` s after the lift.

        MuJoCo uses the larger coefficient of two geoms, so that of the object is limited as well.
        """
        frictions = self._frictions
        for event in self._events:
            done = min(max((time - event.start) / event.duration, 0.0), 1.0)
            if event.kind == "friction" and done > 0:
                final = event.values["friction"]
                frictions = [
                    now + (final - now) * done if now and event.finger in (None, side) else now
                    for side, now in enumerate(frictions, 1)
                ]
        if frictions is self._frictions:
            return
        for sensor, friction in zip(self._world.sensors, frictions, strict=True):
            sensor.set_friction(friction)
        surface = np.minimum(self._surface_friction, min(frictions))
        self._world.model.geom_friction[self._surfaces, 0] = surface

    def _pull(self, event: SampledDisturbance, done: float) -> Array:
        """Return the pulling force (3,), N.

        Once the gripper releases the object, it is held in place and not moved against a finger.
        """
        data = self._world.data
        self.is_taken |= not self._is_held()
        if not self.is_taken:
            return np.array(event.direction) * event.values["force"] * done
        mass = float(self._world.model.body_mass[self._bodies].sum())
        velocity = self._fraction @ data.cvel[self._bodies, 3:]
        return -mass * (self._world.model.opt.gravity + velocity / TAKEN_TIME)

    def _is_held(self) -> bool:
        """Return True if as many membranes are in contact as a grip requires."""
        sensors = self._world.sensors
        return sum(sensor.is_touched for sensor in sensors) >= min(_HOLDS, len(sensors))


def _in_world(event: SampledDisturbance, axes: Array) -> SampledDisturbance:
    """Return the disturbance with its direction in W; `axes` are the path's."""
    x, y, z = (np.array(event.direction) @ axes).tolist()
    return replace(event, direction=(x, y, z))


def _shaken(gravity: Array, event: SampledDisturbance, time: float, done: float) -> Array:
    """Return gravity in a gripper that moves along a direction and tilts, with smooth ends."""
    swell = math.sin(math.pi * done) ** 0.5
    phase = 2 * math.pi * event.values["rate"] * time
    moved = gravity + swell * event.values["acceleration"] * math.sin(phase) * np.array(
        event.direction
    )
    tilt = min(event.values.get("tilt", 0.0), ROTATION_MAX) * swell
    axis = np.cross([0.0, 0.0, 1.0], event.direction)
    length = float(np.linalg.norm(axis))
    if tilt == 0 or length < 1e-6:
        return moved
    quat = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quat, axis / length, tilt)
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, moved, quat)
    return turned


def static_bodies(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the table and the static bodies of the object's file: children of the world."""
    return np.array(
        [
            body
            for body in range(1, model.nbody)
            if model.body_weldid[body] == 0
            and model.body_parentid[body] == 0
            and model.body(body).name.startswith(_PREFIXES)
        ],
        dtype=np.int64,
    )
