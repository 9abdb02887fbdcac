"""`World`: a compiled scene with its sensors, stepped with every step checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from mjtactile.core.errors import InputError, SimulationError
from mjtactile.core.types import Array
from mjtactile.sim.attach import Attachment
from mjtactile.sim.log import route_warnings
from mjtactile.sim.sensor.limits import Flags, Monitor
from mjtactile.sim.sensor.runtime import TactileSensor
from mjtactile.sim.step import advance

_LOOK_EVERY = 0.02  # s, between the checks that cost more than a few microseconds


class World:
    """Owns model and data of a scene with attached sensors.

    MuJoCo answers divergence by silently resetting the state and rewinding time. Here that is off,
    and every step is checked for it: `step` raises SimulationError, never returns a wrong number.
    What makes the numbers worse than usual is in `flags`: the kind of doubt, and its reason when it
    was first seen.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        attachments: Sequence[Attachment],
        place: Callable[[mujoco.MjModel, mujoco.MjData], None] = lambda model, data: None,
    ):
        """`place` puts the fresh state where the scene begins, before anything looks at it."""
        route_warnings()
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        try:
            self.model = spec.compile()
        except ValueError as error:
            raise InputError(
                f"the scene does not compile: {' '.join(str(error).split())}", source="scene"
            ) from error
        self.data = mujoco.MjData(self.model)
        place(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        self.sensors: tuple[TactileSensor, ...] = tuple(
            a.bind(self.model, self.data) for a in attachments
        )
        self.step_count = 0
        # live views
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._warned = self.data.warning.number
        self._monitor = Monitor(self.model, self.data, self.sensors)
        self.flags: Flags = self._monitor.built()
        # steps whose solver ran out of iterations, since the last look and in the one before
        self._unsolved = [0, 0]
        self._look_every = max(1, round(_LOOK_EVERY / self.timestep))
        self._after_step: list[Callable[[], None]] = []
        self._moves = type(self)._before_step is not World._before_step

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self.data.time)

    @property
    def timestep(self) -> float:
        return float(self.model.opt.timestep)

    @property
    def kinetic_energy(self) -> float:
        """J, with each joint's inertia at the model's reference pose; what no quiet scene may
        gain."""
        return float(0.5 * np.asarray(self.model.dof_M0) @ np.square(self.data.qvel))

    def set_control(self, actuator: int, value: float) -> None:
        """Set one actuator's control. Raises InputError when it is not finite (MuJoCo would take it
        for zero)."""
        if not np.isfinite(value):
            raise InputError(
                f"{value!r} is not a finite control",
                source="World",
                field=self.model.actuator(actuator).name,
            )
        self.data.ctrl[actuator] = value

    def step(self, count: int = 1) -> None:
        """Advance by `count` time steps. Raises SimulationError when the state is no longer to be
        trusted."""
        if not (self.sensors or self._after_step or self._moves):  # nothing to do between the steps
            mujoco.mj_step(self.model, self.data, count)
            self.step_count += count
            self._check()
            return
        for _ in range(count):
            self._before_step()
            for sensor in self.sensors:
                sensor.update()
            advance(self.model, self.data)
            self.step_count += 1
            self._check()
            for call in self._after_step:
                call()

    def after_each_step(self, call: Callable[[], None]) -> None:
        """From now on, `call()` after every step."""
        self._after_step.append(call)

    def marker_poses(self, sensor: int) -> tuple[Array, Array]:
        """True marker centres (N, 3) m and outward normals (N, 3) of one sensor in its frame S:
        what its camera sees."""
        return self.sensors[sensor].marker_poses()

    def _before_step(self) -> None:
        """Hook for worlds that move their controls by themselves."""

    def _check(self) -> None:
        if not math.isfinite(self._qpos.dot(self._qpos) + self._qvel.dot(self._qvel)):
            self._fail("the state is not finite")
        if self._warned.dot(self._warned):
            names = [
                mujoco.mjtWarning(int(i)).name.removeprefix("mjWARN_")
                for i in np.flatnonzero(self._warned)
            ]
            self._fail(f"MuJoCo warned: {', '.join(names)}")
        if not self.sensors:
            return
        for sensor in self.sensors:
            reason = sensor.failure()
            if reason:
                self._fail(reason)
        self._unsolved[0] += int(self.data.solver_niter[0] >= self.model.opt.iterations)
        if "speed" not in self.flags:
            self.flags |= self._monitor.hurried()
        if self.step_count % self._look_every == 0:
            self._look()

    def _look(self) -> None:
        flags, stop = self._monitor.look()
        if min(self._unsolved) > 0.5 * self._look_every:
            flags["solver"] = (
                f"the solver did not converge in {self.model.opt.iterations} iterations: forces "
                "are rough; use a "
                "smaller timestep"
            )
        self._unsolved = [0, self._unsolved[0]]
        self.flags = flags | self.flags
        if stop:
            self._fail(stop)

    def _fail(self, reason: str) -> None:
        raise SimulationError(reason, step=self.step_count, time=self.time)
