"""What happens to a held object in a task: it is filled, shaken, pushed, pulled, and the place that
it came from moves.

A shaken or turned hand is gravity that shakes and turns: in the hand's own frame nothing tells the
two apart (the principle of equivalence), any hand can do it, and the cameras look at no table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.task import SampledDisturbance
from mjtactile.core.types import Array
from mjtactile.sim.scenes.objects import PREFIX, moving_bodies

if TYPE_CHECKING:
    from mjtactile.sim.scenes.gripper_world import GripperWorld

_UP = 0.9
"""Of the height that the robot is told to lift to: then the hand is up, and time begins."""
_PLACES = (PREFIX, "table/")
_TAKEN_TIME = 0.02  # s in which somebody who took the object stops it: within 8 mm at 0.4 m/s
_HOLDS = 2  # fingers; what touches one alone is not held
_FASTER = 2.0  # than its lift's speed no hand rises
_FILLS_EVERY = 0.01  # s
_ROTATION_MAX = math.radians(60)


class DisturbanceSchedule:
    """The events of one grasp. `step` after each stretch of the world's steps prepares the next
    one, which ends when it is `due` again: while something happens that is after each step."""

    def __init__(
        self, world: GripperWorld, events: Sequence[SampledDisturbance], lift_height: float
    ):
        model = world.model
        self._world = world
        self._events = events
        self._up = _UP * lift_height
        self._bodies = moving_bodies(model, PREFIX)
        self._share = model.body_mass[self._bodies] / model.body_mass[self._bodies].sum()
        self._lift_speed = world.rig.lift.speed
        self._start_height = float(world.data.xpos[world.start.hand, 2])
        self._gravity = model.opt.gravity.copy()
        self._mass = model.body_mass[self._bodies].copy()
        self._inertia = model.body_inertia[self._bodies].copy()
        self._places = _static_bodies(model)
        self._place_height = model.body_pos[self._places, 2].copy()
        self._first_mass = float(self._mass.sum())
        self.up_since = math.nan
        """s; NaN: the hand was not up yet."""
        self.is_taken = False
        """Somebody pulled it out of the hand, or was given it, and has it from then on."""

    def step(self) -> None:
        """Set masses, gravity, forces and places for the world's next step."""
        world = self._world
        if math.isnan(self.up_since):
            if self._risen() < self._up:
                return
            self.up_since = world.time
        time = world.time - self.up_since
        force = np.zeros(3)
        gravity = self._gravity.copy()
        for event in self._events:
            done = min(max((time - event.begin) / event.last, 0.0), 1.0)
            is_on = 0.0 < done < 1.0
            if event.kind == "fill" and done > 0:
                self._fill(event.values["mass"], done)
            elif event.kind == "table" and done > 0:
                height = event.values["height"] * done
                world.model.body_pos[self._places, 2] = self._place_height + height
            elif event.kind == "shake" and is_on:
                gravity = _shaken(gravity, event, time - event.begin, done)
            elif event.kind == "push" and is_on:
                force += np.array(event.direction) * event.values["impulse"] / event.last
            elif event.kind == "pull" and done > 0:
                force += self._pull(event, done)
        world.model.opt.gravity[:] = gravity
        world.data.xfrc_applied[self._bodies, :3] = self._share[:, None] * force

    def due(self) -> float:
        """s in the world's time at which `step` must be called again at the latest; what is filled
        grows by less than a gram until then."""
        world = self._world
        if math.isnan(self.up_since):
            missing = self._up - self._risen()
            return world.time + missing / (_FASTER * self._lift_speed)
        time = world.time - self.up_since
        due = math.inf
        for event in self._events:
            goes_on = event.kind == "pull" or time < event.begin + event.last + world.timestep
            if goes_on:
                waits = _FILLS_EVERY if event.kind == "fill" else 0.0
                due = min(due, max(event.begin, time + waits))
        return self.up_since + due

    def _risen(self) -> float:
        """m by which the hand is higher than where it began."""
        return float(self._world.data.xpos[self._world.start.hand, 2]) - self._start_height

    def _fill(self, mass: float, done: float) -> None:
        """The object's mass is on its way to `mass` kg, evenly in time, wherever it is in it."""
        model = self._world.model
        ratio = 1 + (mass / self._first_mass - 1) * done
        added = ratio * self._mass - model.body_mass[self._bodies]
        model.body_mass[self._bodies] += added
        model.body_inertia[self._bodies] = ratio * self._inertia
        # each is a tree of its own, in the world's
        model.body_subtreemass[self._bodies] += added
        model.body_subtreemass[0] += added.sum()

    def _pull(self, event: SampledDisturbance, done: float) -> Array:
        """N; who pulls at an object that is let go of has it, and holds it where it is, whatever
        the hand touches then: nobody pulls on at what he has, nor presses it against a finger."""
        data = self._world.data
        self.is_taken |= not self._is_held()
        if not self.is_taken:
            way = np.array([event.direction[0], event.direction[1], abs(event.direction[2])])
            return way * event.values["force"] * done
        mass = float(self._world.model.body_mass[self._bodies].sum())
        velocity = self._share @ data.cvel[self._bodies, 3:]
        return -mass * (self._world.model.opt.gravity + velocity / _TAKEN_TIME)

    def _is_held(self) -> bool:
        """Whether as many membranes touch anything as a grip takes."""
        sensors = self._world.sensors
        return sum(sensor.is_touched for sensor in sensors) >= min(_HOLDS, len(sensors))


def _shaken(gravity: Array, event: SampledDisturbance, time: float, done: float) -> Array:
    """Gravity in a hand that moves along the event's direction and turns about it, which begins
    and ends softly."""
    swell = math.sin(math.pi * done) ** 0.5
    phase = 2 * math.pi * event.values["rate"] * time
    moved = gravity + swell * event.values["acceleration"] * math.sin(phase) * np.array(
        event.direction
    )
    tilt = min(event.values.get("tilt", 0.0), _ROTATION_MAX) * swell
    axis = np.cross([0.0, 0.0, 1.0], event.direction)
    length = float(np.linalg.norm(axis))
    if tilt == 0 or length < 1e-6:
        return moved
    turn = np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, axis / length, tilt)
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, moved, turn)
    return turned


def _static_bodies(model: mujoco.MjModel) -> NDArray[np.int64]:
    """The table, and what of the object's file does not move: children of the world."""
    return np.array(
        [
            body
            for body in range(1, model.nbody)
            if model.body_weldid[body] == 0
            and model.body_parentid[body] == 0
            and model.body(body).name.startswith(_PLACES)
        ],
        dtype=np.int64,
    )
