"""Structs of the kernels of grasps, from a simulated rig and its model."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import warp as wp

from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import load_task
from mjtactile.core.task_sections import SuccessCriteria
from mjtactile.core.types import TaskGoal
from mjtactile.rig.finger import Rig
from mjtactile.sim.fast_reset import movable
from mjtactile.sim.sensing_error_model import SensingErrorModel
from mjtactile.warp.arrays import floats, ints, vectors
from mjtactile.warp.device.disturbances import KINDS
from mjtactile.warp.device.grasp_phase import TaskLimits
from mjtactile.warp.device.gripper import Drive
from mjtactile.warp.device.restart import Scene
from mjtactile.warp.device.sensing_errors import ErrorModel
from mjtactile.warp.device.task_score import Criteria

TASKS = ("lift", "pour", "shake", "bump", "wet", "weigh", "place", "hand-over")
"""Shipped tasks that run on a device."""
_SOURCE = "Grasp-v0 with a device"


def require_supported(scenario: Scenario, rig: Rig) -> None:
    """Raise InputError for a task, object, sensors or rig that do not run on a device."""
    world = rig.scene
    task = load_task(scenario.task)
    kinds = {disturbance.kind for disturbance in task.disturbances}
    if task.waypoints or task.object.liquid or kinds - set(KINDS):
        text = f"{scenario.task!r} needs more than {', '.join(KINDS)}; it does not run on a device"
        raise InputError(text, source=_SOURCE, field="task", choices=TASKS)
    if not movable(world):
        text = "a soft or jointed object, or one with loose geoms, does not run on a device"
        raise InputError(text, source=str(world.object.path), field="object")
    designs = {sensor.design.name for sensor in world.sensors}
    if len(designs) > 1:
        text = f"the fingers have different sensors ({', '.join(sorted(designs))})"
        raise InputError(text, source=_SOURCE, field="rig")
    if world.linear_drive is None:
        text = "its jaws or lift are not linear, which does not run on a device"
        raise InputError(text, source=rig.name, field="rig")


def drive_of(rig: Rig, m: Any, worlds: int) -> Any:
    """Return the drive of the rig, with separate force limits for each world."""
    world = rig.scene
    linear = world.linear_drive
    model = world.model
    jaws = world.jaw_actuators
    drive = Drive()
    drive.opening = float(linear.opening)
    joints = {int(model.jnt_qposadr[j]): int(model.jnt_dofadr[j]) for j in range(model.njnt)}
    drive.read = ints(linear.read)
    drive.velocity = ints([joints[int(q)] for q in linear.read])
    drive.per = floats(linear.per)
    drive.controls, drive.affine = ints(linear.controls), floats(linear.affine)
    drive.jaws = ints([actuator.id for actuator, _ in jaws])
    drive.ratios = floats([law.ratio for _, law in jaws])
    drive.stiffness = floats([actuator.stiffness for actuator, _ in jaws])
    drive.damping = floats([actuator.damping for actuator, _ in jaws])
    ranges = np.where(
        model.actuator_forcelimited[:, None], model.actuator_forcerange, [-np.inf, np.inf]
    ).astype(np.float32)
    drive.force_range = wp.array(ranges, dtype=wp.vec2)
    drive.forces = m.actuator_forcerange = wp.array(np.tile(ranges, (worlds, 1, 1)), dtype=wp.vec2)
    drive.fraction = 2 / len(rig.fingers)
    drive.opening_max = float(rig.limits.opening[1])
    drive.lift_speed = float(rig.limits.lift_speed)
    lift = world.lift_joint
    drive.lift_read, drive.lift_ratio = lift if lift is not None else (-1, 0.0)
    return drive


def limits_of(rig: Rig, goal: TaskGoal) -> Any:
    """Return the goal of a task and the limits of the rig's commands."""
    limits = TaskLimits()
    of_rig = rig.limits
    limits.lift_height, limits.hold_time = float(goal.lift_height), float(goal.hold_time)
    limits.handover = int(goal.handover)
    limits.opening_min, limits.opening_max = (float(opening) for opening in of_rig.opening)
    limits.speed, limits.force = float(of_rig.speed), float(of_rig.force)
    limits.lift_max, limits.lift_speed = float(of_rig.lift[1]), float(of_rig.lift_speed)
    limits.period = float(rig.period)
    return limits


def criteria_of(success: SuccessCriteria) -> Any:
    """Return the success criteria of a task."""
    criteria = Criteria()
    for name in Criteria.vars:
        setattr(criteria, name, float(getattr(success, name)))
    return criteria


_PER_WORLD: dict[str, Any] = {
    **dict.fromkeys(("body_pos", "body_ipos", "body_inertia"), wp.vec3),
    **dict.fromkeys(("geom_size", "geom_pos", "geom_friction", "geom_aabb"), wp.vec3),
    **dict.fromkeys(("body_quat", "body_iquat", "geom_quat"), wp.quat),
    **dict.fromkeys(("body_mass", "body_subtreemass", "geom_rbound"), float),
    "body_invweight0": wp.vec2,
    "geom_dataid": int,
}


def scene_of(model: mujoco.MjModel, m: Any, worlds: int, gripper: int, friction: float) -> Any:
    """Return the model's fields that differ between worlds, as arrays with a row for each.

    `gripper` is the MuJoCo body that the lift carries.
    """
    scene = Scene()
    for name, kind in _PER_WORLD.items():
        rows = np.repeat(getattr(m, name).numpy()[:1], worlds, axis=0)
        array = wp.array(rows, dtype=kind)
        setattr(m, name, array)
        setattr(scene, name, array)
    scene.diagonal = floats(np.tile(model.dof_M0, (worlds, 1)))
    scene.body_of = ints(model.geom_bodyid)
    scene.friction = vectors(model.geom_friction)
    scene.membrane_friction = float(friction)
    scene.gripper = int(model.body_rootid[gripper])
    scene.height = float(model.body_pos[scene.gripper, 2])
    return scene


def error_model(errors: SensingErrorModel) -> Any:
    """Return the errors of a sensing pipeline on the device."""
    model = ErrorModel()
    model.loads, model.table = floats(errors.loads), floats(errors.at_loads)
    model.gain = floats(errors.gain)
    model.spread = floats(np.linalg.cholesky(errors.correlation))
    model.outlier_size = floats(errors.outlier_size)
    model.slow_time, model.shear_gain = float(errors.slow_time), float(errors.shear_gain)
    model.touch_force, model.release = float(errors.touch_force), float(errors.release)
    return model
