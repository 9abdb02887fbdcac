"""MuJoCo step without the first solve, on which the result does not depend.

Under `discrete`, `mj_step` solves twice. The first solve computes `qacc_smooth`, the acceleration
without contacts and equalities. It uses conjugate gradients up to `opt.tolerance`. The second solve
computes the real acceleration. It uses the first only as a start value, if that is the better one.
With membranes, the first solve takes half of a step's time.

No public switch separates the two solves. The manual's stages of a step lack the operations of
`discrete` between them. `mj_forwardSkip` contains these operations. Here it runs once without
iterations. Then the real solve runs alone with the requested tolerance (decision 16).
"""

from __future__ import annotations

from typing import Any

import mujoco

NO_ITERATION = 1e10
"""Tolerance with which the first solve ends at once."""
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
    """Advance `data` by one time step in place of `mj_step`.

    The result is equal within the tolerance of `model.opt`. The first solve goes to
    `first_tolerance`. With `opt.tolerance` the state is that of `mj_step` bit for bit. Afterwards
    `data.qacc_smooth` has the accuracy of the first solve.

    `mj_step` is called where the result depends on the first solve. An example is a MuJoCo body
    without constraints or contacts. The same holds for unsupported options. A control callback is
    called twice per step.
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
    data.flg_rnepost = False  # the cached accelerometer quantities belong to another acceleration
    mujoco.mj_sensorAcc(model, data)
    mujoco.mj_checkAcc(model, data)
    _integrate(model, data)


def _integrate(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Integrate v += h a, q += h v, and the other states: `mj_Euler` without its damping."""
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
    """Return True if the second solve covers all degrees of freedom."""
    return data.nefc > 0 and (data.nidof == model.nv or bool(model.opt.disableflags & _ISLANDS))
