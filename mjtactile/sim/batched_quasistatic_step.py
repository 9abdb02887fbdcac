"""`QuasistaticStepper`: many steps of a gripper with quasi-static membranes in one kernel.

One kernel (`kernels/qs_substeps.c`) performs the steps of `GripperWorld` and `Stepper`. It calls
MuJoCo by the addresses of its functions and releases the Python GIL. It stops early if Python must
check an event.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.kernels import bound
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

MAX_STEPS = 64
"""Steps in one call."""


@dataclass(frozen=True)
class Drive:
    """Linear drive of jaws and lift.

    `opening` is that at qpos = 0, m. It changes by `per` (k,) m per unit of the qpos entries `read`
    (k,). `controls` (n,) are actuator ids. `affine` (n, 3) are coefficients of their controls:
    value with both goals 0, change per m of opening and per m of lift.
    """

    opening: float
    read: Array
    per: Array
    controls: Array
    affine: Array


class QuasistaticStepper:
    """Batched steps of one model and data; `sensors` are bound to them.

    `goals` (4,) m is a writable view of current and requested opening, current and requested lift.
    `maximum` (3,) m is one of limits: change of the opening goal per step, lead of that goal over
    the jaws, and change of the lift goal per step.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        sensors: Sequence[QuasistaticSensor],
        drive: Drive,
        movers: Array,
        max_speeds: Array,
    ):
        """Bind the kernel; the degrees of freedom `movers` (n,) have limits `max_speeds` (n,)."""
        self._data = data
        self._sensors = tuple(sensors)
        self._goals = np.zeros(8)
        self._goals[7] = drive.opening
        self.goals = self._goals[:4]
        self.maximum = self._goals[4:7]
        self._wrenches = np.zeros((MAX_STEPS, len(sensors), 6))
        self._counts = np.zeros(4, np.int64)
        self._max_speeds = np.ascontiguousarray(max_speeds, float)
        follows = np.array([sensor.follow_message() for sensor in sensors])
        pushes = np.array([sensor.push_message() for sensor in sensors])
        self._limits = self._max_speeds.copy()
        mujoco_addresses = np.array([*_functions(), model._address, data._address], np.int64)
        membranes = (len(sensors), follows, pushes, sensors[0].add_messages())
        opening = (len(drive.read), np.ascontiguousarray(drive.read, np.int64), drive.per)
        ids = np.ascontiguousarray(drive.controls, np.int64)
        controls = (len(ids), ids, np.ascontiguousarray(drive.affine, float))
        state = (model.nv, data.qvel, len(movers), np.ascontiguousarray(movers, np.int64))
        self._run = bound(
            "qs_steps",
            *(..., mujoco_addresses, ..., float(model.opt.timestep), *membranes, self._goals),
            *(*opening, model.nq, data.qpos, *controls, model.nu, data.ctrl),
            *(*state, self._limits, int(model.opt.iterations), data.solver_niter),
            *(..., self._counts),
        )

    def is_ready(self) -> bool:
        """Return True if all valves are closed, as required. Also update the gas for leakage."""
        return all(sensor.hold_gas() for sensor in self._sensors)

    def run(self, count: int, watch_speed: bool) -> tuple[int, int, Array]:
        """Run up to `count` steps; fewer without convergence or, with `watch_speed`, at high speed.

        Return the number of steps done, the number in which the solver ran out of iterations, and
        the wrench (n, sensors, 6) on each sensor in each step.
        """
        self._limits[:] = self._max_speeds if watch_speed else np.inf
        wrenches = self._wrenches[:count]
        self._run(count, float(self._data.time), wrenches)
        done, unsolved = self._counts[:2].tolist()
        return done, unsolved, wrenches[:done]


def is_available() -> bool:
    """Return True if MuJoCo's library and the required addresses are available."""
    return bool(_functions()) and hasattr(mujoco.MjModel, "_address")


@cache
def _functions() -> tuple[int, ...]:
    """Return the addresses of mj_kinematics and mj_step; empty if the library is not found."""
    folder = Path(mujoco.__file__).parent
    found = [
        *folder.glob("libmujoco.so*"),
        *folder.glob("libmujoco*.dylib"),
        *folder.glob("mujoco.dll"),
    ]
    if not found:
        return ()
    library = ctypes.CDLL(str(found[0]))
    functions = (library.mj_kinematics, library.mj_step)
    return tuple(ctypes.cast(function, ctypes.c_void_p).value or 0 for function in functions)
