"""Position actuators of any model, described by their length.

They drive jaws, lifts and arms. A position actuator has the force g u + b0 + b1 l + b2 l', MuJoCo's
"fixed" gain and "affine" bias, with b1 < 0. The control u therefore sets a goal for its length l,
an angle or a distance of its joint or tendon, times the gear.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array

_GOAL_DYNAMICS = (
    int(mujoco.mjtDyn.mjDYN_NONE),
    int(mujoco.mjtDyn.mjDYN_FILTER),
    int(mujoco.mjtDyn.mjDYN_FILTEREXACT),
)
"""Dynamics that bring the activation to the control; an integrator does not."""
SCALAR_JOINTS = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))


class PositionActuator:
    """One position actuator of a compiled model, with its present length.

    Raises InputError for an actuator that holds no position.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, source: str):
        self._model = model
        self._data = data
        self.id = int(model.actuator(name).id)
        self.name = name
        gain = model.actuator_gainprm[self.id]
        bias = model.actuator_biasprm[self.id]
        affine = (
            model.actuator_gaintype[self.id] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[self.id] == mujoco.mjtBias.mjBIAS_AFFINE
        )
        follows = model.actuator_dyntype[self.id] in _GOAL_DYNAMICS
        if not affine or not follows or gain[0] == 0 or bias[1] >= 0:
            forces = static_forces(model, self.id, float(data.actuator_length[self.id]))
            raise InputError(
                "is not a position actuator: its control sets no goal for its position; it pushes "
                f"with {_range_text(*forces)}",
                source=source,
                field=f"actuator {name!r}",
                choices=["<position>", '<general biastype="affine" …>'],
            )
        self.stiffness = float(-bias[1])
        self.damping = float(-bias[2])
        self._per_length = float(-bias[1] / gain[0])
        self._zero = float(-bias[0] / gain[0])
        self.joints, self.gears = _joints(model, self.id)
        self._qpos = model.jnt_qposadr[self.joints]
        self.dofs = model.jnt_dofadr[self.joints]
        gears = self.gears.tolist()
        self.reads = list(zip(self._qpos.tolist(), gears, strict=True))
        """Addresses in qpos that determine its length, with their factors."""
        self._moves = list(zip(self.dofs.tolist(), gears, strict=True))
        self._asked: float | None = None  # last limit, N or N m
        self._range = force_range(model, self.id)
        self.force_limit = float(self._range[1])

    @property
    def length(self) -> float:
        if not len(self.joints):
            return float(self._data.actuator_length[self.id])
        qpos = self._data.qpos
        return float(sum(gear * qpos[q] for q, gear in self.reads))

    @property
    def speed(self) -> float:
        if not len(self.joints):
            return float(self._data.actuator_velocity[self.id])
        qvel = self._data.qvel
        return float(sum(gear * qvel[d] for d, gear in self._moves))

    @property
    def force(self) -> float:
        """Force in the last step, N or N m."""
        return float(self._data.actuator_force[self.id])

    def force_towards(self, goal: float, length: float) -> float:
        """Return the force at rest, N or N m, with this goal at this length.

        The control is within the model's `ctrlrange`, the force within its limits.
        """
        control = self._zero + self._per_length * goal
        return static_force(self._model, self.id, control, length, self._range)

    def limit_force(self, force: float) -> None:
        """Limit the force to at most `force` from now on, within the model's own limit."""
        if force == self._asked:
            return
        self._asked = force
        self.force_limit = float(min(force, self._range[1]))
        self._model.actuator_forcelimited[self.id] = True
        self._model.actuator_forcerange[self.id] = (
            max(-force, self._range[0]),
            min(force, self._range[1]),
        )

    @property
    def is_linear(self) -> bool:
        """True if the length depends on joints alone."""
        return len(self.joints) > 0

    @property
    def control(self) -> tuple[float, float]:
        """Its control where its goal is a length of 0, and by unit of that."""
        return self._zero, self._per_length

    def set_goal(self, length: float) -> None:
        self._data.ctrl[self.id] = self._zero + self._per_length * length

    def place(self, length: float, data: mujoco.MjData) -> None:
        """Set the joints in `data` to this length, distributed by the gears."""
        squares = sum(gear * gear for gear in self.gears)
        for gear, q in zip(self.gears, self._qpos, strict=True):
            data.qpos[q] = gear * length / squares

    def moment(self, data: mujoco.MjData) -> Array:
        """Return the derivative (1, nv) of its length, after `mj_fwdPosition` of `data`."""
        row = np.zeros((1, self._model.nv))
        start = int(data.moment_rowadr[self.id])
        count = int(data.moment_rownnz[self.id])
        row[0, data.moment_colind[start : start + count]] = data.actuator_moment[
            start : start + count
        ]
        return row


def force_range(model: mujoco.MjModel, actuator: int) -> Array:
    """Return the limits (2,) of an actuator's force, N or N m: its own, its joints', its tendon's.

    They are infinite without limits.
    """
    limits = np.array([-np.inf, np.inf])
    if model.actuator_forcelimited[actuator]:
        limits = model.actuator_forcerange[actuator].copy()
    joints, gears = _joints(model, actuator)
    bounds = [
        np.sort(model.jnt_actfrcrange[joint] / gear)
        for joint, gear in zip(joints, gears, strict=True)
        if model.jnt_actfrclimited[joint] and gear
    ]
    target = int(model.actuator_trnid[actuator, 0])
    gear = float(model.actuator_gear[actuator, 0])
    on_tendon = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON
    if on_tendon and model.tendon_actfrclimited[target] and gear:
        bounds.append(np.sort(model.tendon_actfrcrange[target] / gear))
    for low, high in bounds:
        limits = np.array([max(limits[0], low), min(limits[1], high)])
    return limits


def static_force(
    model: mujoco.MjModel, actuator: int, control: float, length: float, limits: Array
) -> float:
    """Return an actuator's force at rest, N or N m, at a length, within `limits`.

    The control is limited to `ctrlrange`. Other gains than "fixed" and "affine" count as 1.
    """
    if model.actuator_ctrllimited[actuator]:
        control = float(np.clip(control, *model.actuator_ctrlrange[actuator]))
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    kind = model.actuator_gaintype[actuator]
    factor = 1.0
    if kind == mujoco.mjtGain.mjGAIN_FIXED:
        factor = gain[0]
    elif kind == mujoco.mjtGain.mjGAIN_AFFINE:
        factor = gain[0] + gain[1] * length
    force = factor * control if factor else 0.0
    if model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE:
        force += bias[0] + bias[1] * length
    return float(np.clip(force, *limits))


def static_forces(model: mujoco.MjModel, actuator: int, length: float) -> tuple[float, float]:
    """Return the minimum and maximum force at rest over an actuator's controls, N or N m."""
    limits = force_range(model, actuator)
    forces = [
        static_force(model, actuator, control, length, limits) for control in (-np.inf, np.inf)
    ]
    return min(forces), max(forces)


def _range_text(low: float, high: float) -> str:
    """Return a force range as text."""
    return f"{low:.3g} to {high:.3g} N or N m" if np.isfinite(high - low) else "unlimited force"


def _joints(model: mujoco.MjModel, actuator: int) -> tuple[Array, Array]:
    """Return the slides and hinges of an actuator and the length per unit of each; may be empty."""
    kind = model.actuator_trntype[actuator]
    target = int(model.actuator_trnid[actuator, 0])
    gear = float(model.actuator_gear[actuator, 0])
    if kind == mujoco.mjtTrn.mjTRN_JOINT:
        joints = np.array([target])
        gears = np.array([gear])
    elif kind == mujoco.mjtTrn.mjTRN_TENDON:
        start = int(model.tendon_adr[target])
        count = int(model.tendon_num[target])
        rows = slice(start, start + count)
        if not (model.wrap_type[rows] == int(mujoco.mjtWrap.mjWRAP_JOINT)).all():
            return np.zeros(0, int), np.zeros(0)
        joints = model.wrap_objid[rows]
        gears = gear * model.wrap_prm[rows]
    else:
        return np.zeros(0, int), np.zeros(0)
    simple = np.isin(model.jnt_type[joints], SCALAR_JOINTS).all()
    return (joints, gears) if simple else (np.zeros(0, int), np.zeros(0))
