"""Lift of a simulated rig: an actuator, a mocap body, an arm, or none.

All heights are in m above the start position.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.scenes.actuators import PositionActuator
from mjtactile.sim.scenes.initial_state import ArmPath, Start


class Lift(Protocol):
    """Interface of a lift, which controls the height of the gripper."""

    def height(self) -> float:
        """Return the height reported by the rig."""
        ...

    def drive(self, height: float) -> None:
        """Set the goal of the lift."""
        ...

    def place(self, height: float, data: mujoco.MjData) -> None:
        """Set the lift to this height in `data`, which may differ from the world's state."""
        ...


def make_lift(model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile, start: Start) -> Lift:
    if rig.lift.kind == "actuator":
        return ActuatorLift(model, data, rig)
    if rig.lift.kind == "mocap":
        return MocapLift(model, data, rig, start)
    if rig.lift.kind == "arm":
        assert start.path is not None
        return ArmLift(model, data, rig, start, start.path)
    return NoLift()


class NoLift:
    """Placeholder of a rig without a lift: it reports every requested height as reached."""

    def __init__(self) -> None:
        self._height = 0.0

    def height(self) -> float:
        return self._height

    def drive(self, height: float) -> None:
        self._height = height

    def place(self, height: float, data: mujoco.MjData) -> None:
        self._height = height


class ActuatorLift:
    """One position actuator; its length at the start counts as height 0."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile):
        self._actuator = PositionActuator(model, data, rig.lift.name, str(rig.path))
        self._ratio = rig.lift.ratio
        self._start = self._actuator.length

    def height(self) -> float:
        return (self._actuator.length - self._start) * self._ratio

    def affine(self) -> tuple[int, float, float]:
        """The actuator, its control at height 0, and by m of height."""
        zero, per_length = self._actuator.control
        return self._actuator.id, zero + per_length * self._start, per_length / self._ratio

    def drive(self, height: float) -> None:
        self._actuator.set_goal(self._start + height / self._ratio)

    def place(self, height: float, data: mujoco.MjData) -> None:
        self._actuator.place(self._start + height / self._ratio, data)


class GripperHeight:
    """Height of the gripper from forward kinematics of the current joints, as reported by an
    arm."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, hand: int):
        self._model = model
        self._data = data
        self._hand = hand
        self._kinematics = mujoco.MjData(model)
        self._start = self._now()

    def height(self) -> float:
        return self._now() - self._start

    def _now(self) -> float:
        self._kinematics.qpos[:] = self._data.qpos
        self._kinematics.mocap_pos[:] = self._data.mocap_pos
        mujoco.mj_kinematics(self._model, self._kinematics)
        return float(self._kinematics.xpos[self._hand, 2])


class MocapLift(GripperHeight):
    """Mocap body to which the gripper, or its arm, is welded."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile, start: Start):
        super().__init__(model, data, start.hand)
        self._mocap = int(model.body(rig.lift.name).mocapid[0])
        self._from = float(start.mocap_pos[self._mocap, 2])

    def drive(self, height: float) -> None:
        self.place(height, self._data)

    def place(self, height: float, data: mujoco.MjData) -> None:
        data.mocap_pos[self._mocap, 2] = self._from + height


class ArmLift(GripperHeight):
    """Arm on the path computed by `plan_start`."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        rig: SimRigFile,
        start: Start,
        path: ArmPath,
    ):
        super().__init__(model, data, start.hand)
        self._path = path
        self._actuators = [
            PositionActuator(model, data, name, str(rig.path)) for name in path.actuators
        ]
        joints: Array = np.concatenate([actuator.joints for actuator in self._actuators])
        self._qpos = model.jnt_qposadr[joints]

    def drive(self, height: float) -> None:
        for actuator, goal in zip(self._actuators, self._path.at(height), strict=True):
            actuator.set_goal(float(goal))

    def place(self, height: float, data: mujoco.MjData) -> None:
        data.qpos[self._qpos] = self._path.qpos(height)[self._qpos]
