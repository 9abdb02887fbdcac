"""`World`: a compiled scene with its sensors, stepped with every step checked."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.sim.attach import Attachment
from mjtactile.sim.log import route_warnings
from mjtactile.sim.sensor.any import AnySensor
from mjtactile.sim.sensor.limits import Flags
from mjtactile.sim.stepper import Stepper


class World:
    """Owns model and data of a scene with attached sensors.

    MuJoCo's way with divergence, to reset the state and rewind time, is off: `step` raises
    SimulationError, never returns a wrong number.
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
        self.sensors: tuple[AnySensor, ...] = tuple(
            a.bind(self.model, self.data) for a in attachments
        )
        self._stepper = Stepper(self.model, self.data, self.sensors)
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

    @property
    def flags(self) -> Flags:
        """What makes the numbers worse than usual: the kind of doubt, and its reason when it was
        first seen."""
        return self._stepper.flags

    @property
    def step_count(self) -> int:
        return self._stepper.step_count

    def step(self, count: int = 1) -> None:
        """Advance by `count` time steps. Raises SimulationError when the state is no longer to be
        trusted."""
        if not (self.sensors or self._after_step or self._moves):  # nothing to do between the steps
            mujoco.mj_step(self.model, self.data, count)
            self._stepper.after_step(count)
            return
        for _ in range(count):
            self._before_step()
            self._stepper.step()
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

    def _watch(self, watcher: Callable[[], Flags]) -> None:
        """From now on, take in the flags of `watcher` at each look at the state."""
        self._stepper.watchers.append(watcher)
