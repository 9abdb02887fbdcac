"""Initial state of a simulated rig: jaws open, gripper over the table, tips at grasp height.

It is planned on the robot with its sensors alone. Table and object come last in the model, so that
the addresses and ids of earlier elements stay the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.finite_model import require_finite
from mjtactile.sim.scenes.actuators import PositionActuator
from mjtactile.sim.scenes.inverse_kinematics import Condition, actuator_at, gripper_pose_at, solve
from mjtactile.sim.scenes.mjcf import read_mjcf

_TOLERANCE = 1e-4  # tolerance of a reached posture, m and rad
# height step between an arm's postures, m, linear between: within 5 um on a path of 0.3 m radius
_PATH_STEP = 4e-3


@dataclass(frozen=True, eq=False)
class Start:
    """Initial state of the robot, in the model passed to `plan_start`.

    `gripper` is the MuJoCo body that carries all fingers. `centre` (3,) m is the fingertips' mean
    position before the gripper was `raised` by that many m, and `origin` (3,) m that of `gripper`.
    `yaw` rad is the closing direction of finger 0; `path` is that of an arm.
    """

    qpos: Array
    mocap_pos: Array
    gripper: int
    centre: Array
    origin: Array
    yaw: float
    raised: float
    path: ArmPath | None = None


@dataclass(frozen=True, eq=False)
class ArmPath:
    """Goals (n, a) of an arm's `actuators` and `joints` (n, nq) for n `heights` m above its start.

    The goals lead the joints by the servos' deflection under gravity.
    """

    actuators: tuple[str, ...]
    heights: Array
    goals: Array
    joints: Array
    solve_pose: Callable[[float, Array], Array]
    """Goals (a,) for a height and a displacement; it raises InputError if the arm cannot reach
    them."""

    def at(self, height: float) -> Array:
        """Return the actuator goals (a,) for a height, m."""
        return _interpolated_row(self.heights, self.goals, height)

    def qpos(self, height: float) -> Array:
        """Return the coordinates (nq,) of the planned model for a height, m. Only the arm's are
        valid."""
        return _interpolated_row(self.heights, self.joints, height)


def missing_names(spec: mujoco.MjSpec, rig: SimRigFile) -> Iterator[InputError]:
    """Yield an error for each name of the rig file that the MJCF lacks."""
    required = [("site", finger.site, f"finger[{i}].site") for i, finger in enumerate(rig.fingers)]
    required += [
        ("actuator", a.name, f"gripper.actuator[{i}].name")
        for i, a in enumerate(rig.gripper.actuators)
    ]
    required += [("actuator", name, "lift.actuators") for name in rig.lift.actuators]
    if rig.lift.kind == "actuator":
        required.append(("actuator", rig.lift.name, "lift.actuator"))
    if rig.lift.kind == "mocap":
        required.append(("mocap body", rig.lift.name, "lift.body"))
    if rig.keyframe is not None:
        required.append(("keyframe", rig.keyframe, "sim.keyframe"))
    elements = {
        "site": spec.sites,
        "actuator": spec.actuators,
        "keyframe": spec.keys,
        "mocap body": [body for body in spec.bodies if body.mocap],
    }
    for kind, name, field in required:
        names = [element.name for element in elements[kind] if element.name]
        if name not in names:
            text = f"{rig.model.name} has no {kind} {name!r}"
            yield InputError(text, source=rig.path, field=field, choices=names)
    sites = [finger.site for finger in rig.fingers]
    if len(set(sites)) != len(sites):
        yield InputError(
            f"two fingers have the same site: {sites}", source=rig.path, field="finger.site"
        )


def load_robot(rig: SimRigFile) -> tuple[mujoco.MjSpec, dict[str, Array], Array | None]:
    """Return the user's model, and joint coordinates and mocap positions of its start keyframe.

    Keyframes are removed, because they would not fit the model with sensors. Raises InputError for
    a broken file or a missing name.
    """
    spec = read_mjcf(rig.model)
    try:
        for error in missing_names(spec, rig):
            raise error
        for index, joint in enumerate(spec.joints):
            joint.name = joint.name or f"unnamed joint {index}"
        model = spec.compile()
    except (ValueError, RuntimeError) as error:
        raise InputError(
            f"not valid MJCF: {' '.join(str(error).split())}", source=rig.model
        ) from error
    require_finite(model, rig.model)
    coordinates: dict[str, Array] = {}
    mocap = None
    if rig.keyframe is not None:
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key(rig.keyframe).id)
        coordinates = {model.joint(j).name: data.joint(j).qpos.copy() for j in range(model.njnt)}
        mocap = data.mocap_pos.copy()
    for key in list(spec.keys):
        spec.delete(key)
    return spec, coordinates, mocap


def plan_start(
    model: mujoco.MjModel,
    rig: SimRigFile,
    bodies: Sequence[int],
    opening: float,
    height: Callable[[Array], float],
    coordinates: Mapping[str, Array],
    mocap: Array | None,
    grip: float | None = None,
) -> Start:
    """Plan the initial state on the robot's `model`, whose sensor `bodies` are given.

    `height` returns the required height of the fingertips' center, m, from their rotations R_WS
    (fingers, 3, 3). Their position refers to the opening `grip`, m, at contact with the object
    (None: the initial opening). Raises InputError if the jaws, or an arm, cannot reach the state.
    """
    data = mujoco.MjData(model)
    for name, value in coordinates.items():
        data.joint(name).qpos[:] = value
    if mocap is not None:
        data.mocap_pos[:] = mocap
    jaws = place_jaws(model, data, rig, opening)
    wrong = f"the jaws do not open to {1e3 * opening:g} mm (check the sign of the transmission)"
    _settle(model, data, jaws, rig, "gripper.opening_start_mm", wrong)
    gripper = _gripper_body(model, bodies, rig)
    rotations = data.xmat[bodies].reshape(-1, 3, 3)
    centre = data.xpos[bodies].mean(axis=0)
    if grip is not None:
        centre = _centre_at(model, data, rig, bodies, grip, centre)
    origin = data.xpos[gripper].copy()
    yaw = math.atan2(rotations[0, 1, 2], rotations[0, 0, 2])
    raised = height(rotations) - centre[2]
    path = None
    if rig.lift.kind == "mocap":
        data.mocap_pos[model.body(rig.lift.name).mocapid[0], 2] += raised
        wrong = "the gripper does not follow the mocap body to the grasp height"
        _settle(model, data, jaws, rig, "lift.body", wrong)
    elif rig.lift.kind == "arm":
        path = _plan_path(model, data, rig, gripper, centre, raised, jaws, yaw)
    start_pose = data.qpos.copy(), data.mocap_pos.copy()
    return Start(*start_pose, gripper, centre.copy(), origin, yaw, raised, path)


def _centre_at(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    rig: SimRigFile,
    bodies: Sequence[int],
    opening: float,
    start: Array,
) -> Array:
    """Return the fingertips' mean position (3,) m with the jaws at `opening` m, else `start`."""
    low, high = rig.gripper.opening
    moved = mujoco.MjData(model)
    moved.qpos[:] = data.qpos
    moved.mocap_pos[:] = data.mocap_pos
    moved.mocap_quat[:] = data.mocap_quat
    conditions = place_jaws(model, moved, rig, min(max(opening, low), high))
    if solve(model, moved, conditions) > _TOLERANCE:
        return start
    centre = moved.xpos[bodies].mean(axis=0)
    return centre if np.linalg.norm(centre - start) > _TOLERANCE else start


def place_jaws(
    model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile, opening: float
) -> list[Condition]:
    """Put the jaws' joints at the positions of their laws; return the conditions that remain."""
    conditions = []
    for jaw in rig.gripper.actuators:
        actuator = PositionActuator(model, data, jaw.name, str(rig.path))
        length = jaw.transmission.coordinate(opening / len(rig.gripper.actuators))
        actuator.place(length, data)
        conditions.append(actuator_at(actuator, length))
    return conditions


def _settle(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    conditions: Sequence[Condition],
    rig: SimRigFile,
    field: str,
    wrong: str,
) -> None:
    remainder = solve(model, data, conditions)
    if remainder > _TOLERANCE:
        text = f"{wrong}: {1e3 * remainder:.2g} mm or mrad remain"
        raise InputError(text, source=rig.path, field=field)


def _gripper_body(model: mujoco.MjModel, bodies: Sequence[int], rig: SimRigFile) -> int:
    """Return the nearest MuJoCo body that carries all fingers."""
    ancestors = []
    for body in bodies:
        line = [int(model.body_parentid[body])]
        while line[-1]:
            line.append(int(model.body_parentid[line[-1]]))
        ancestors.append(line)
    gripper = next(body for body in ancestors[0] if all(body in line for line in ancestors))
    if gripper == 0:
        raise InputError(
            "no body carries all fingers: there is no gripper to lift",
            source=rig.path,
            field="finger.site",
        )
    return gripper


def _plan_path(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    rig: SimRigFile,
    gripper: int,
    centre: Array,
    raised: float,
    jaws: Sequence[Condition],
    yaw: float,
) -> ArmPath:
    """Move the arm to the start (in `data`), and find its postures over the whole travel."""
    actuators = [
        PositionActuator(model, data, name, str(rig.path))
        for name in arm_actuators(model, gripper, rig)
    ]
    dofs = np.concatenate([actuator.dofs for actuator in actuators])
    R_WH = data.xmat[gripper].reshape(3, 3).copy()
    point_H = R_WH.T @ (centre - data.xpos[gripper])
    heights = np.linspace(0.0, rig.lift.travel, max(2, math.ceil(rig.lift.travel / _PATH_STEP) + 1))
    moving = mujoco.MjData(model)
    moving.qpos[:] = data.qpos
    moving.mocap_pos[:] = data.mocap_pos

    def solve_pose(target: Array, R_WH: Array) -> tuple[Array, float]:
        """Return the goals and the remaining error of a posture, which `moving` then has."""
        pose = gripper_pose_at(model, gripper, point_H, target, R_WH, dofs)
        rest = solve(model, moving, [*jaws, pose])
        mujoco.mj_fwdVelocity(model, moving)
        return np.array([_goal_under_gravity(moving, actuator) for actuator in actuators]), rest

    goals = []
    joints = []
    for height in heights:
        target = centre + [0.0, 0.0, raised + height]
        goal, rest = solve_pose(target, R_WH)
        if height == 0:
            _require_reached(rig, target, rest, "the table", "lift.kind")
            data.qpos[:] = moving.qpos
        else:
            where = f"{1e3 * height:.0f} mm above its start"
            _require_reached(rig, target, rest, where, "lift.travel_mm")
        joints.append(moving.qpos.copy())
        goals.append(goal)

    def displaced(height: float, displacement: Array) -> Array:
        offset = displacement[:3] @ _axes(yaw) + [0.0, 0.0, raised + height]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, _turn(yaw, displacement[3]))
        goal, rest = solve_pose(centre + offset, rotation.reshape(3, 3) @ R_WH)
        _require_reached(rig, centre + offset, rest, "a waypoint of the task", "lift.kind")
        return goal

    names = tuple(actuator.name for actuator in actuators)
    return ArmPath(names, heights, np.array(goals), np.array(joints), displaced)


def _require_reached(rig: SimRigFile, target: Array, rest: float, where: str, field: str) -> None:
    """Raise InputError if the remaining error of a posture for `target` is too large."""
    if rest > _TOLERANCE:
        text = (
            f"the arm does not reach {where}: the fingertips would be at {_mm(target)} mm, and "
            f"{1e3 * rest:.1f} mm or mrad remain"
        )
        raise InputError(text, source=rig.path, field=field)


def path_axes(start: Start) -> Array:
    """Return the axes (3, 3) of a path in W, as rows: closing direction, across it, up."""
    return _axes(start.yaw)


def path_turn(start: Start, tilt: float) -> Array:
    """Return the quaternion (4,) of a tilt about the closing direction."""
    return _turn(start.yaw, tilt)


def path_rise(start: Start, displacement: Array) -> float:
    """Return the height that a displacement adds to the gripper's origin, m."""
    turned = np.zeros(3)
    arm = start.origin - start.centre
    mujoco.mju_rotVecQuat(turned, arm, path_turn(start, displacement[3]))
    return float(displacement[2] + turned[2] - arm[2])


def _axes(yaw: float) -> Array:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _turn(yaw: float, tilt: float) -> Array:
    rotation = np.zeros(4)
    mujoco.mju_axisAngle2Quat(rotation, _axes(yaw)[0], tilt)
    return rotation


def arm_actuators(model: mujoco.MjModel, gripper: int, rig: SimRigFile) -> tuple[str, ...]:
    """Return the position actuators that move the gripper: the rig file's, or all of its arm."""
    if rig.lift.actuators:
        return rig.lift.actuators
    pipeline = arm_joints(model, gripper)
    jaws = {jaw.name for jaw in rig.gripper.actuators}
    found = [
        model.actuator(i).name
        for i in range(model.nu)
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        and model.actuator_trnid[i, 0] in pipeline
    ]
    found = [name for name in found if name and name not in jaws]
    if not found:
        raise InputError(
            "no position actuator moves a joint between the world and the gripper",
            source=rig.path,
            field="lift.actuators",
        )
    return tuple(found)


def arm_joints(model: mujoco.MjModel, gripper: int) -> list[int]:
    """Return the joints between the world and the gripper."""
    joints = []
    body = gripper
    while body:
        first = int(model.body_jntadr[body])
        joints += range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return joints


def _goal_under_gravity(data: mujoco.MjData, actuator: PositionActuator) -> float:
    """Return the goal that holds the current length against weight and springs, after
    `mj_fwdVelocity`."""
    gears = actuator.gears
    if not len(gears):
        return float(data.actuator_length[actuator.id])
    torque = (data.qfrc_bias - data.qfrc_passive)[actuator.dofs] @ gears / (gears @ gears)
    return float(data.actuator_length[actuator.id] + torque / actuator.stiffness)


def _interpolated_row(heights: Array, rows: Array, height: float) -> Array:
    """Interpolate linearly between the rows of evenly spaced `heights`."""
    index = min(max(height / (heights[1] - heights[0]), 0.0), len(heights) - 1.0)
    low = min(int(index), len(heights) - 2)
    return rows[low] + (index - low) * (rows[low + 1] - rows[low])


def _mm(point: Array) -> str:
    return ", ".join(f"{1e3 * value:.0f}" for value in point)
