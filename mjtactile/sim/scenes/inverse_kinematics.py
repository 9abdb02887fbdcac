"""Inverse kinematics of a robot by damped least squares (Wampler 1986; Nakamura, Hanafusa 1986).

Conditions are the model's equality constraints, lengths of actuators, and the gripper pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.sim.scenes.actuators import SCALAR_JOINTS, PositionActuator

Condition = Callable[[mujoco.MjData], tuple[Array, Array]]
"""Function of a state after `mj_fwdPosition`: residual (m,), m and rad, and Jacobian (m, nv)."""

CLOSE = 1e-7  # convergence tolerance, m and rad
_ITERATIONS = 100
_DAMPING = 1e-3  # damping of the least squares; limits the steps at a singular posture
_STEP = 0.3  # maximum motion of a joint per iteration, rad and m


def solve(model: mujoco.MjModel, data: mujoco.MjData, conditions: Sequence[Condition]) -> float:
    """Move `data.qpos` until `conditions` and equality constraints hold. Return the largest
    residual.

    A state that meets them is left as it is, to the bit.
    """
    for _ in range(_ITERATIONS):
        _keep_ranges(model, data)
        mujoco.mj_fwdPosition(model, data)
        parts = [_equalities(model, data), *(condition(data) for condition in conditions)]
        missing, jacobian = (np.concatenate(part) for part in zip(*parts, strict=True))
        rest = float(np.abs(missing).max(initial=0.0))
        if rest < CLOSE:
            break
        square = jacobian @ jacobian.T + _DAMPING**2 * np.eye(len(missing))
        step = jacobian.T @ np.linalg.solve(square, missing)
        step *= min(1.0, _STEP / max(float(np.abs(step).max()), 1e-12))
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    return rest


def actuator_at(actuator: PositionActuator, length: float) -> Condition:
    """Return the condition that the actuator has this length."""

    def condition(data: mujoco.MjData) -> tuple[Array, Array]:
        return np.array([length - data.actuator_length[actuator.id]]), actuator.moment(data)

    return condition


def gripper_pose_at(
    model: mujoco.MjModel, body: int, point_H: Array, p_W: Array, R_WH: Array, dofs: Array
) -> Condition:
    """Return the condition that `body` has rotation `R_WH` and its `point_H` is at `p_W`, by
    `dofs`."""
    jacobian = np.zeros((6, model.nv))
    others = np.setdiff1d(np.arange(model.nv), dofs)

    def condition(data: mujoco.MjData) -> tuple[Array, Array]:
        R_now = data.xmat[body].reshape(3, 3)
        p_now = data.xpos[body] + R_now @ point_H
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], p_now, body)
        jacobian[:, others] = 0.0
        rotation = 0.5 * np.cross(R_now.T, R_WH.T).sum(axis=0)
        return np.concatenate([p_W - p_now, rotation]), jacobian.copy()

    return condition


def _equalities(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Return the residuals of the equality constraints and their Jacobian."""
    rows = np.flatnonzero(data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY))
    dense = np.zeros((data.nefc, model.nv))
    if not len(rows):
        return np.zeros(0), dense[:0]
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(
            dense, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
        )
    else:
        dense = np.asarray(data.efc_J).reshape(data.nefc, model.nv)
    return -data.efc_pos[rows], dense[rows]


def _keep_ranges(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Clip slides and hinges to their ranges."""
    for joint in np.flatnonzero(model.jnt_limited):
        if model.jnt_type[joint] in SCALAR_JOINTS:
            address = model.jnt_qposadr[joint]
            data.qpos[address] = np.clip(data.qpos[address], *model.jnt_range[joint])
