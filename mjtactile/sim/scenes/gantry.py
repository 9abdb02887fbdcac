"""`Gantry`: joints and servos that move the base of a gripper sideways, up and by a tilt.

They are added only to scenes of tasks with waypoints. Other scenes stay as they are.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.gripper_path import GripperPath
from mjtactile.core.types import Array
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.scenes.initial_state import Start, path_axes

_PREFIX = "gantry "
_AXES = ("x", "y", "z", "tilt")
_CHECKS = 40  # checked positions of an arm on a path
_ARMATURE = 1.0  # inertia of the vertical servo, kg
_FREQUENCY = 2 * math.pi * 25.0  # natural frequency of the servos, rad/s; critically damped


def add_gantry(spec: mujoco.MjSpec, model: mujoco.MjModel, start: Start) -> None:
    """Add the joints to the base of the gripper in the compiled `model`.

    x is the closing direction of the first finger. The tilt axis is parallel to it. It passes
    through the center of the fingertips.
    """
    root = int(model.body_rootid[start.gripper])
    base = next(body for body in spec.bodies if body.id == root)
    data = mujoco.MjData(model)
    data.qpos[:] = start.qpos
    mujoco.mj_kinematics(model, data)
    R_WB = data.xmat[root].reshape(3, 3)
    axes = path_axes(start)
    anchor = R_WB.T @ (start.centre - data.xpos[root])
    for name, axis_W in zip(_AXES, (*axes, axes[0]), strict=True):
        is_hinge = name == "tilt"
        kind = mujoco.mjtJoint.mjJNT_HINGE if is_hinge else mujoco.mjtJoint.mjJNT_SLIDE
        # z is parallel to the lift of the same body: without its own inertia M is singular
        armature = _ARMATURE if name == "z" else 0.0
        joint = {"name": _PREFIX + name, "type": kind, "armature": armature}
        base.add_joint(**joint, axis=R_WB.T @ axis_W, pos=anchor)
        actuator = spec.add_actuator(
            name=_PREFIX + name, target=_PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        actuator.set_to_position(kp=1.0, kv=0.0)


def require_path(rig: SimRigFile, start: Start, path: GripperPath) -> None:
    """Raise InputError for a rig that cannot follow the path of a task."""
    if rig.lift.kind == "none":
        text = "the gripper does not move sideways, and the task has waypoints"
        choices = ["actuator", "mocap", "arm"]
        raise InputError(text, source=rig.path, field="lift.kind", choices=choices)
    if start.path is None:
        return
    for time in np.linspace(0.0, path.end, _CHECKS):
        for height in (0.0, start.path.heights[len(start.path.heights) // 2]):
            start.path.solve_pose(height, path.at(float(time)))


class Gantry:
    """Servos of a gantry in the compiled scene."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self._data = data
        self._servos = [model.actuator(_PREFIX + name).id for name in _AXES]
        for servo, name in zip(self._servos, _AXES, strict=True):
            inertia = float(model.dof_M0[model.joint(_PREFIX + name).dofadr[0]])
            stiffness = inertia * _FREQUENCY**2
            model.actuator_gainprm[servo, 0] = stiffness
            model.actuator_biasprm[servo, 1] = -stiffness
            model.actuator_biasprm[servo, 2] = -2 * inertia * _FREQUENCY

    def drive(self, displacement: Array) -> None:
        """Set the goals: x, y, z, m, and tilt, rad, of a path."""
        self._data.ctrl[self._servos] = displacement


def has_gantry(model: mujoco.MjModel) -> bool:
    """Return True if the compiled scene has a gantry."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, _PREFIX + _AXES[0]) >= 0
