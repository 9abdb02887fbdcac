"""Drives of a simulated rig: jaws, and lift by an actuator, a mocap body, an arm, or none.

Heights are in m above the start position. A displacement (4,) of a path is x, y, z, m, and tilt,
rad. The height of the lift does not contain it.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.rig.jaw_transmission import LINEAR, JawLaw
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.batched_quasistatic_step import Drive
from mjtactile.sim.scenes.actuators import PositionActuator
from mjtactile.sim.scenes.gantry import Gantry, has_gantry
from mjtactile.sim.scenes.initial_state import ArmPath, Start, path_axes, path_rise, path_turn


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

    def displace(self, displacement: Array) -> None:
        """Set the goal of the path; it acts from the next `drive` on."""
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

    def displace(self, displacement: Array) -> None:
        """Do nothing: such a rig is refused for tasks with a path."""


class ActuatorLift:
    """One position actuator; its length at the start counts as height 0. A gantry moves its
    base."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile):
        self._gantry = Gantry(model, data) if has_gantry(model) else None
        self._actuator = PositionActuator(model, data, rig.lift.name, str(rig.path))
        self._ratio = rig.lift.ratio
        self._start = self._actuator.length

    def height(self) -> float:
        return (self._actuator.length - self._start) * self._ratio

    def joint(self) -> tuple[int, float] | None:
        """Return the qpos entry of its joint, 0 at the start, and m of height per unit of it."""
        if len(self._actuator.reads) != 1 or self._start:
            return None
        ((address, gear),) = self._actuator.reads
        return address, gear * self._ratio

    def affine(self) -> tuple[int, float, float]:
        """Return the actuator, its control at height 0, and the control per m of height."""
        zero, per_length = self._actuator.control
        return self._actuator.id, zero + per_length * self._start, per_length / self._ratio

    def drive(self, height: float) -> None:
        self._actuator.set_goal(self._start + height / self._ratio)

    def place(self, height: float, data: mujoco.MjData) -> None:
        self._actuator.place(self._start + height / self._ratio, data)

    def displace(self, displacement: Array) -> None:
        if self._gantry is not None:
            self._gantry.drive(displacement)


class GripperHeight:
    """Height of the gripper from forward kinematics of the current joints, as of an arm.

    The height of the path is subtracted.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, start: Start):
        self._model = model
        self._data = data
        self._gripper = start.gripper
        self._path_start = start
        self._kinematics = mujoco.MjData(model)
        self._start = self._now()
        self._displacement: Array | None = None
        self._raised = 0.0

    def height(self) -> float:
        return self._now() - self._start - self._raised

    def displace(self, displacement: Array) -> None:
        self._displacement = displacement
        self._raised = path_rise(self._path_start, displacement)

    def _now(self) -> float:
        self._kinematics.qpos[:] = self._data.qpos
        self._kinematics.mocap_pos[:] = self._data.mocap_pos
        mujoco.mj_kinematics(self._model, self._kinematics)
        return float(self._kinematics.xpos[self._gripper, 2])


class MocapLift(GripperHeight):
    """Mocap body to which the gripper, or its arm, is welded."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile, start: Start):
        super().__init__(model, data, start)
        self._mocap = int(model.body(rig.lift.name).mocapid[0])
        self._from = start.mocap_pos[self._mocap].copy()
        self._turned = data.mocap_quat[self._mocap].copy()

    def drive(self, height: float) -> None:
        self.place(height, self._data)
        if self._displacement is not None:
            self._place_on_path(height, self._displacement)

    def _place_on_path(self, height: float, displacement: Array) -> None:
        """Move and tilt the mocap body about the center of the fingertips."""
        start = self._path_start
        rotation = path_turn(start, displacement[3])
        tips = start.centre + [0.0, 0.0, start.raised]
        offset = displacement[:3] @ path_axes(start) + [0.0, 0.0, height]
        rotated = np.zeros(3)
        mujoco.mju_rotVecQuat(rotated, self._from - tips, rotation)
        self._data.mocap_pos[self._mocap] = tips + rotated + offset
        mujoco.mju_mulQuat(self._data.mocap_quat[self._mocap], rotation, self._turned)

    def place(self, height: float, data: mujoco.MjData) -> None:
        data.mocap_pos[self._mocap, 2] = self._from[2] + height


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
        super().__init__(model, data, start)
        self._path = path
        self._actuators = [
            PositionActuator(model, data, name, str(rig.path)) for name in path.actuators
        ]
        joints: Array = np.concatenate([actuator.joints for actuator in self._actuators])
        self._qpos = model.jnt_qposadr[joints]

    def drive(self, height: float) -> None:
        goals = self._path.at(height)
        if self._displacement is not None:
            goals = self._path.solve_pose(height, self._displacement)
        for actuator, goal in zip(self._actuators, goals, strict=True):
            actuator.set_goal(float(goal))

    def place(self, height: float, data: mujoco.MjData) -> None:
        data.qpos[self._qpos] = self._path.qpos(height)[self._qpos]


class Jaws:
    """All actuators that open and close. The opening is the sum of their parts.

    For more than two fingers, the opening is twice the mean distance of the fingertips from the
    center. Each of n fingers closes with 2/n of the mean of the actuators' forces, by virtual work.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile):
        self.actuators: list[tuple[PositionActuator, JawLaw]] = [
            (PositionActuator(model, data, jaw.name, str(rig.path)), jaw.transmission)
            for jaw in rig.gripper.actuators
        ]
        self._fraction = 2 / len(rig.fingers)
        self._closed = rig.gripper.opening[0]
        self._force_limit = rig.gripper.force_max
        self.limit_force(self._force_limit)

    def opening(self) -> float:
        """Return the opening computed from the actuators' lengths, m."""
        return float(sum(law.part(actuator.length) for actuator, law in self.actuators))

    def speed(self) -> float:
        """Return the rate of change of the opening, m/s, negative while closing."""
        return float(
            sum(law.slope(actuator.length) * actuator.speed for actuator, law in self.actuators)
        )

    def force(self) -> float:
        """Return the closing force on each finger, as indicated by the servo currents, N."""
        forces = [actuator.force / law.slope(actuator.length) for actuator, law in self.actuators]
        return -self._fraction * sum(forces) / len(forces)

    def limit_force(self, force: float) -> None:
        """Limit the force on each finger to `force` N and to the actuators' maximum."""
        self._force_limit = force
        for actuator, law in self.actuators:
            actuator.limit_force(force / self._fraction * abs(law.slope(actuator.length)))

    def force_available(self, opening: float) -> float:
        """Return the maximum closing force of the actuators on each finger at rest, N.

        The goal of the jaws is then the minimum opening of the rig file.
        """
        forces = []
        for actuator, law in self.actuators:
            length, goal = (
                law.coordinate(x / len(self.actuators)) for x in (opening, self._closed)
            )
            forces.append(-actuator.force_towards(goal, length) / law.slope(length))
        return self._fraction * sum(forces) / len(forces)

    def finger_force(self, work: float) -> float:
        """Return the force on each finger, N, of loads that do `work` J per m of closing."""
        return self._fraction * work

    def max_lead(self, speed: float) -> float:
        """Return the lead of a goal over the opening for the full force at `speed` m/s, m."""
        count = len(self.actuators)
        leads = []
        for actuator, law in self.actuators:
            slope = abs(law.slope(actuator.length))
            force = 1.2 * actuator.force_limit + actuator.damping * (speed / (count * slope))
            leads.append(force / actuator.stiffness * slope * count)
        return min(leads)

    def drive(self, opening: float) -> None:
        """Set the goal of every actuator, shared equally."""
        for actuator, law in self.actuators:
            actuator.set_goal(law.coordinate(opening / len(self.actuators)))

    def drive_with(self, lift: Lift) -> Drive | None:
        """Return jaws and lift as linear coefficients; None if one of them is not linear."""
        known = isinstance(lift, (ActuatorLift, NoLift))
        if not known or not all(law.kind == LINEAR and a.is_linear for a, law in self.actuators):
            return None
        reads = [(q, law.ratio * gear) for a, law in self.actuators for q, gear in a.reads]
        drives = []
        for actuator, law in self.actuators:
            zero, per_length = actuator.control
            per = per_length / law.ratio
            drives.append((actuator.id, zero - per * law.offset, per / len(self.actuators), 0.0))
        if isinstance(lift, ActuatorLift):
            actuator_id, zero, per = lift.affine()
            drives.append((actuator_id, zero, 0.0, per))
        table = np.array(drives)
        return Drive(
            sum(law.offset for _, law in self.actuators),
            np.array([q for q, _ in reads]),
            np.array([per for _, per in reads]),
            table[:, 0],
            table[:, 1:],
        )

    def refresh_force(self) -> None:
        """Keep the force on the fingers at its limit where the lever changes with the opening."""
        if any(law.kind != "linear" for _, law in self.actuators):
            self.limit_force(self._force_limit)
