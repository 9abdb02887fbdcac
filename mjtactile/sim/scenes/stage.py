"""Stages that move an indenter or an object over an upward-facing sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.recording.stage_protocol import Move
from mjtactile.sim.scenes.indentation import PressWorld
from mjtactile.sim.scenes.mjcf import take_options
from mjtactile.sim.scenes.objects import PREFIX, ObjectModel, read_spec

LIFTED = -2e-3  # depth relative to first touch, m: no contact


def current(moves: Sequence[Move], time: float) -> int | None:
    """Return the index of the newest move that is due; None before the first."""
    return max((i for i, move in enumerate(moves) if move.time <= time + 1e-9), default=None)


class StageDrive:
    """Stage that executes moves on an inflated `world`, with `offset` m added to depths.

    Raises InputError for a move whose depth is defined by a force.
    """

    def __init__(self, world: PressWorld, moves: Sequence[Move], offset: float = 0.0):
        if any(move.is_weight for move in moves):
            raise InputError(
                "the simulated stage moves to depths; weights are for a real stage",
                field="depth_mm",
            )
        self._world = world
        self._moves = moves
        self._offset = offset
        self._depth = LIFTED
        self._shear = 0.0
        self._first = world.step_count
        self._now = 0.0

    def advance_to(self, time: float) -> None:
        """Step the world to `time` s after the start, towards the newest move's target."""
        end = self._first + round(time / self._world.timestep)
        index = current(self._moves, self._now)
        if index is not None:
            self._follow(self._moves[index], (end - self._world.step_count) * self._world.timestep)
        if self._world.step_count < end:
            self._world.step(end - self._world.step_count)
        self._now = time

    def _follow(self, move: Move, seconds: float) -> None:
        depth = LIFTED if math.isnan(move.depth) else move.depth + self._offset
        displacement = np.array([depth - self._depth, move.shear - self._shear])
        longest = float(np.abs(displacement).max())
        if longest > 0 and seconds > 0:
            part = min(1.0, move.speed * seconds / longest)
            self._depth = self._depth + part * displacement[0]
            self._shear = self._shear + part * displacement[1]
            self._world.drive(self._depth, self._shear, move.speed)


class ObjectOnStage:
    """Object in a holder, at pose `p_HO` (3,) m and `R_HO` (3, 3) relative to the holder."""

    def __init__(self, model: ObjectModel, p_HO: Array, R_HO: Array):
        if model.flex_material is not None:
            raise InputError(
                f"{model.name!r} is a soft body of finite elements, which a holder cannot hold",
                source="explore",
                field="object",
            )
        self.model = model
        self._p_HO = p_HO
        self._R_HO = R_HO

    def add_to(self, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        """Add the object, without its free joint and other MuJoCo bodies, to `body` of `spec`."""
        held = read_spec(self.model)
        item = held.body("object")
        for other in list(held.worldbody.bodies):
            if other.name != "object":
                held.delete(other)
        for joint in list(item.joints):
            if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                held.delete(joint)
        item.pos = [0.0, 0.0, 0.0]
        item.quat = [1.0, 0.0, 0.0, 0.0]
        frame = body.add_frame(pos=self._p_HO, quat=quaternion(self._R_HO))
        take_options(held, spec)
        spec.attach(held, frame=frame, prefix=PREFIX)


class ObjectOnStageWorld(PressWorld):
    """The holder's frame is H. `world` goes to `PressWorld` (mesh, timestep, effects)."""

    def __init__(self, sensor: SensorDesign, mounted: ObjectOnStage, **world):
        super().__init__(sensor, mounted, **world)
        self._body = self.model.body("indenter").id
        self._holder = self.model.body("holder").id

    def turn(self, R_SH: Array, p_H: Array) -> None:
        """Rotate the holder to `R_SH`, and lower its point `p_H` (3,) m to just above the
        sensor."""
        self.lift_off()
        self.settle()
        over = R_SH @ p_H
        self.model.body_quat[self._holder] = quaternion(R_SH)
        self.model.body_pos[self._body, :2] = -over[:2]
        self._find_touch()

    @property
    def p_SH(self) -> Array:
        """Position (3,) m of the holder's origin in S, as the stage shows it."""
        drive = [self.data.qpos[joint] for joint in self._joints]
        return np.array([drive[0], 0.0, drive[1] + self.start_height]) + [
            *self.model.body_pos[self._body, :2],
            0.0,
        ]


def quaternion(R: Array) -> Array:
    """Return the quaternion (4,) of a rotation (3, 3)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(R).ravel())
    return quat
