"""`QuasistaticStepper`: many steps of a hand whose sensors are films without Python between them.

Of a step of 2 ms MuJoCo and the films need some 40 us; calling them one after the other from Python
takes several times that. Here one kernel (`kernels/qs_substeps.c`) does what `GripperWorld` and
`Stepper` do step by step, calls MuJoCo by the addresses of its functions, and lets go of Python
meanwhile, so that worlds in threads use all processors. It ends early where something must be
looked at.
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

MOST = 64
"""Steps in one go."""
_RAN = 0
_UNSOLVED = 1


@dataclass(frozen=True)
class Drive:
    """How jaws and lift are driven, all of it linear.

    Attributes:
        opening: m, of the jaws where all of qpos is 0.
        read: (k,) places in qpos that the opening hangs on.
        per: (k,) m of it for each unit.
        controls: (n,) actuators.
        affine: (n, 3) a control's value where both goals are 0, and by m of opening and of lift.
    """

    opening: float
    read: Array
    per: Array
    controls: Array
    affine: Array


class QuasistaticStepper:
    """Steps of one model and data, which `sensors` are bound to.

    Attributes:
        goals: (4,) m: opening now and wanted, lift now and wanted; a view, to be written.
        most: (3,) m that the opening's goal goes in a step, that it is ahead of the jaws, and that
            the lift's goes in a step; a view.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        sensors: Sequence[QuasistaticSensor],
        drive: Drive,
        movers: Array,
        hurry: Array,
    ):
        """`movers` and `hurry` (n,) are degrees of freedom and the speeds at which they are too
        fast."""
        self._data = data
        self._sensors = tuple(sensors)
        self._goals = np.zeros(8)
        self._goals[7] = drive.opening
        self.goals = self._goals[:4]
        self.most = self._goals[4:7]
        self._wrenches = np.zeros((MOST, len(sensors), 6))
        self._told = np.zeros(4, np.int64)
        self._hurry = np.ascontiguousarray(hurry, float)
        self._never = np.full(len(hurry), np.inf)
        follows = np.array([sensor.follow_message() for sensor in sensors])
        pushes = np.array([sensor.push_message() for sensor in sensors])
        self._hurries = self._hurry.copy()
        self._run = bound(
            "film_steps",
            ...,
            np.array([*_functions(), model._address, data._address], np.int64),
            ...,
            float(model.opt.timestep),
            len(sensors),
            follows,
            pushes,
            sensors[0].add_messages(),
            self._goals,
            len(drive.read),
            np.ascontiguousarray(drive.read, np.int64),
            np.ascontiguousarray(drive.per, float),
            model.nq,
            data.qpos,
            len(drive.controls),
            np.ascontiguousarray(drive.controls, np.int64),
            np.ascontiguousarray(drive.affine, float),
            model.nu,
            data.ctrl,
            model.nv,
            data.qvel,
            len(movers),
            np.ascontiguousarray(movers, np.int64),
            self._hurries,
            int(model.opt.iterations),
            data.solver_niter,
            ...,
            self._told,
        )

    def is_ready(self) -> bool:
        """Whether all valves are closed, as they must be; what gas has leaked is looked at."""
        return all(sensor.hold_gas() for sensor in self._sensors)

    def run(self, count: int, watch_speed: bool) -> tuple[int, int, Array]:
        """Do up to `count` steps; fewer, where a film finds no rest, or something is too fast that
        is watched.

        Args:
            count: At most MOST.
            watch_speed: Whether to end where something is too fast.

        Returns:
            How many were done, in how many the solver ran out of iterations, and the wrench (n,
                sensors, 6) on each sensor in each.
        """
        self._hurries[:] = self._hurry if watch_speed else self._never
        wrenches = self._wrenches[:count]
        self._run(count, float(self._data.time), wrenches)
        done = int(self._told[_RAN])
        return done, int(self._told[_UNSOLVED]), wrenches[:done]


def is_there() -> bool:
    """Whether MuJoCo's library and addresses are to be had here."""
    return bool(_functions()) and hasattr(mujoco.MjModel, "_address")


@cache
def _functions() -> tuple[int, ...]:
    """Addresses of mj_kinematics and mj_step in the library that Python's module uses; none where
    it is not found."""
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
    return tuple(ctypes.cast(one, ctypes.c_void_p).value or 0 for one in functions)
