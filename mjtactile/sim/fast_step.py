"""A step of MuJoCo without the solve that nothing rests on.

Under `discrete`, `mj_step` solves twice: first for the acceleration that there would be without
contacts and equalities (`qacc_smooth`), by conjugate gradients up to `opt.tolerance`; then for the
real one, in which the first is only a start that is taken when it is the better one. With
membranes, the first is half of a step's time. No public switch separates the two, and the stages of
which the manual makes up a step lack what `discrete` does between them. `mj_forwardSkip` has it:
here it runs once without iterations, then the real solve alone with the tolerance that was asked
for (decision 16).
"""

from __future__ import annotations

from typing import Any

import mujoco

NO_ITERATION = 1e10
"""Tolerance with which the first solve is over before it begins."""
_UNKNOWN = ~int(
    mujoco.mjtEnableBit.mjENBL_OVERRIDE
    | mujoco.mjtEnableBit.mjENBL_ENERGY
    | mujoco.mjtEnableBit.mjENBL_INVDISCRETE
    | mujoco.mjtEnableBit.mjENBL_DIAGEXACT
)  # flags to enable
_ISLANDS = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
_EULERDAMP = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)


def advance(
    model: mujoco.MjModel, data: mujoco.MjData, *, first_tolerance: float = NO_ITERATION
) -> None:
    """Advance `data` by one time step in place of `mj_step`: the same to the tolerance of
    `model.opt`.

    The first solve goes to `first_tolerance`; with `opt.tolerance` the state is that of `mj_step`
    bit for bit. Afterwards `data.qacc_smooth` is as good as that. Where the result does rest on it,
    as of a body that nothing holds and nothing touches, and under options that this does not know,
    it is `mj_step`. A control callback is asked twice a step.
    """
    option = model.opt
    if not _is_known_kind(option):
        mujoco.mj_step(model, data)
        return
    mujoco.mj_step1(model, data)
    if not _is_constrained(model, data):
        mujoco.mj_step2(model, data)
        return
    tolerance = option.tolerance
    option.tolerance = first_tolerance
    try:
        mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_VEL, 1)
    finally:
        option.tolerance = tolerance
    mujoco.mj_fwdConstraint(model, data)
    data.flg_rnepost = False  # what accelerometers rest on is of another acceleration
    mujoco.mj_sensorAcc(model, data)
    mujoco.mj_checkAcc(model, data)
    _integrate(model, data)


def _integrate(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """v += h a, q += h v, and what else a state has. `mj_Euler` does just that where it leaves
    damping alone, which under `discrete` is in the acceleration already."""
    option = model.opt
    flags = option.disableflags
    option.disableflags = flags | _EULERDAMP
    try:
        mujoco.mj_Euler(model, data)
    finally:
        option.disableflags = flags


def _is_known_kind(option: Any) -> bool:
    return (
        option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
        and option.solver != mujoco.mjtSolver.mjSOL_PGS
        and not option.noslip_iterations
        and not option.enableflags & _UNKNOWN
    )


def _is_constrained(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether all degrees of freedom are in the second solve: it leaves out islands without a
    constraint."""
    return data.nefc > 0 and (data.nidof == model.nv or bool(model.opt.disableflags & _ISLANDS))
