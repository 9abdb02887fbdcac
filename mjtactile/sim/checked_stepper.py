"""`Stepper`: advances a compiled scene with sensors, and checks every step.

On divergence, MuJoCo resets the state and rewinds time. A checked scene raises a `SimulationError`
instead. Reduced accuracy alone only sets a flag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import SimulationError
from mjtactile.core.flags import Cadence, Flag, FlagTracker, Reasons
from mjtactile.core.types import Array
from mjtactile.sim.fast_step import advance
from mjtactile.sim.sensor.monitor import SceneMonitor
from mjtactile.sim.sensor.sensor_types import AnySensor

# period of the more expensive checks, s; quasi-static membranes check much themselves
_CHECK_PERIOD = 0.02
_QS_CHECK_PERIOD = 0.1


class Stepper:
    """Checked stepper of a scene with `sensors`, which are bound to its model and data.

    Each of `watchers` is called at every check and returns flags of its own.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, sensors: Sequence[AnySensor]):
        self._model = model
        self._data = data
        self._sensors = tuple(sensors)
        self._qpos = data.qpos  # live views
        self._qvel = data.qvel
        # a membrane with a NaN among these reports no contact
        self._inputs = {
            "mocap_pos": data.mocap_pos,
            "mocap_quat": data.mocap_quat,
            "option.gravity": model.opt.gravity,
        }
        self._warnings = data.warning.number
        self._old_warnings = int(self._warnings.sum())
        self._monitor = SceneMonitor(model, data, self._sensors)
        self._unsolved = [0, 0]
        """Steps whose solver ran out of iterations: since the last check, and in the period before
        it."""
        period = _QS_CHECK_PERIOD if self._monitor.only_quasistatic else _CHECK_PERIOD
        self._check_every = max(1, round(period / float(model.opt.timestep)))
        self._built = self._monitor.initial_flags()
        self._tracker = FlagTracker(float(data.time), self._built)
        self.step_count = 0
        self.watchers: list[Callable[[], Reasons]] = []

    @property
    def flags(self) -> dict[str, Flag]:
        """Flags so far, by kind."""
        return self._tracker.flags(float(self._data.time))

    @property
    def is_speed_flagged(self) -> bool:
        """True if an object was too fast for the step; single steps then need no check of speed."""
        return "speed" in self._tracker

    def update_flags(self, reasons: Reasons, checked: Collection[Cadence] = ()) -> None:
        """Add the result of a check that is not one of the stepper; see `FlagTracker.update`."""
        self._tracker.update(float(self._data.time), reasons, checked)

    def step(self) -> None:
        """Advance by one time step. Raises SimulationError when the state is not to be trusted."""
        self.before_step()
        advance(self._model, self._data)
        self.after_step()

    def before_step(self) -> None:
        """Bring the gas of all sensors up to the present state."""
        for sensor in self._sensors:
            sensor.update()

    @property
    def speeds(self) -> tuple[NDArray[np.int64], Array]:
        """See `SceneMonitor.speeds`."""
        return self._monitor.speeds

    @property
    def contact_counts(self) -> tuple[int, int]:
        """See `SceneMonitor.contact_counts`."""
        return self._monitor.contact_counts

    @property
    def steps_to_check(self) -> int:
        """Number of steps until the next check."""
        return self._check_every - self.step_count % self._check_every

    def after_step(self, count: int = 1, unsolved: int | None = None) -> None:
        """Check the state after `count` steps, `unsolved` of which ran out of iterations (None: the
        last is checked).

        Raises SimulationError if the state is not finite, MuJoCo warned, or a membrane failed.
        """
        self.step_count += count
        if not math.isfinite(self._qpos.dot(self._qpos) + self._qvel.dot(self._qvel)):
            self._stop("the state is not finite")
        if int(self._warnings.sum()) > self._old_warnings:
            self._stop(f"MuJoCo warned: {', '.join(self._warning_names())}")
        if not self._sensors:
            return
        self._check_sensors()
        if unsolved is None:
            unsolved = int(self._data.solver_niter[0] >= self._model.opt.iterations)
        self._unsolved[0] += unsolved
        if not self.is_speed_flagged and (hurried := self._monitor.speed_flags()):
            self.update_flags(hurried)
        if self.step_count % self._check_every == 0:
            self._check()
            return
        reason = self._monitor.tunneled_geom(every=False)
        if reason:
            self._stop(reason)

    def _check_sensors(self) -> None:
        for sensor in self._sensors:
            reason = sensor.failure()
            if reason:
                self._stop(reason)
            if urgent := sensor.unsolved_flags():
                self.update_flags(urgent)

    def _check(self) -> None:
        for name, values in self._inputs.items():
            if not np.isfinite(values).all():
                self._stop(f"{name} is not finite")
        flags, checked, reason = self._monitor.check()
        if min(self._unsolved) > 0.5 * self._check_every:
            flags["solver"] = (
                f"the solver did not converge in {self._model.opt.iterations} iterations: "
                "forces are inaccurate; use a smaller timestep"
            )
        self._unsolved = [0, self._unsolved[0]]
        for watcher in self.watchers:
            flags |= watcher()
        self.update_flags(flags | self._built, checked)
        if reason:
            self._stop(reason)

    def _warning_names(self) -> list[str]:
        kinds = np.flatnonzero(self._warnings)
        return [mujoco.mjtWarning(int(kind)).name.removeprefix("mjWARN_") for kind in kinds]

    def _stop(self, reason: str) -> None:
        raise SimulationError(reason, step=self.step_count, time=float(self._data.time))
