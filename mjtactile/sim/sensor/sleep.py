"""Sleep of an untouched sensor: its membrane is removed from the solve and restored exactly.

MuJoCo's own sleep applies to whole kinematic trees. Here the membrane is declared rigid and the gas
tendon loses its joints. A separate spring holds every vertex in place. These springs couple no
vertices: a step takes 0.04 ms instead of 0.25. The membrane's own inertia and weight are left out.
Their changes therefore wake the sensor.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.sim.sensor.membrane import ANYTHING
from mjtactile.sim.sensor.mesh import MembraneMesh

NEAR = 5e-3
"""Distance, m, of anything that may touch at which a sensor wakes: a step of 4 ms at 1 m/s."""
STILL = 1e-4
STILL_MIN = 1e-9
"""Limits of vertex motion between two checks: a fraction of the largest displacement, and a
minimum, m. Shapes settle within 10 ms."""
# change of the frame's weight vector or acceleration that wakes the sensor, m/s^2; the membrane
# responds by about 0.5 um
SHAKEN = 0.5
_TURNING = 0.1  # rad/s of the frame
# period of checks of an awake sensor, s; number of still checks in a row before sleep
_CHECK_PERIOD = 0.01
_TIMES = 3
_HOLD = 0.1  # minimum time that a woken sensor stays awake, s
_BULGED = 1.2  # ratio of vertex distances on the inflated to those on the flat membrane
_STIFFNESS = 1e5  # stiffness per vertex, N/m: its weight moves it by less than 1 nm


class Sleeper:
    """Sleep and wake-up of one sensor's membrane; `load` applies the pressure."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        mesh: MembraneMesh,
        load: Any,
        flex_id: int,
        body_id: int,
        vertex_geoms: np.ndarray,
    ):
        self._model = model
        self._data = data
        self._load = load
        self._flex = flex_id
        self._body = body_id
        self._first = int(vertex_geoms[0])
        self._last = int(vertex_geoms[-1])
        self._geoms = slice(self._first, self._last + 1)
        bodies = model.geom_bodyid[vertex_geoms]
        self._bodies = slice(int(bodies[0]), int(bodies[-1]) + 1)
        # a ninth of the vertices
        sample = np.arange(len(bodies)).reshape(mesh.nx - 2, mesh.ny - 2)[1::3, 1::3].ravel()
        p_SV = mesh.p_SV[mesh.interior]
        between = np.linalg.norm(p_SV[:, None] - p_SV[sample], axis=2).min(axis=1).max()
        self._sample = self._first + sample
        self._margin = NEAR + _BULGED * float(between)
        self._pushes = data.xfrc_applied[self._bodies]  # a live view: the vertices are one block
        joint = int(model.body_jntadr[bodies[0]])
        self._joints = slice(joint, joint + 3 * len(mesh.interior))
        address = int(model.jnt_qposadr[joint])
        self._springs = model.qpos_spring[address : address + 3 * len(mesh.interior)]
        self._velocity: list[float] = data.cvel[body_id].tolist()
        self._weight = [np.nan] * 3
        self._kept = tuple[Array, ...]()
        self._before: Array = np.full_like(load.displacements, np.nan)
        self._time = float(data.time)
        self._calm = 0
        self._after = -np.inf
        self.asleep = False
        self._undo()

    def wakes(self) -> bool:
        """Return True if near geoms, motion, forces or moved vertices disturb a sleeping sensor."""
        data = self._data
        return bool(
            self._is_near()
            or self._is_moved()
            or self._pushes.any()
            or not self._time <= data.time
            or np.abs(self._load.displacements - self._springs).max() > 1e-6
        )

    def may_sleep(self, gas_is_still: bool) -> bool:
        """Return True if an awake sensor was still for several checks in a row; call every step."""
        time = float(self._data.time)
        if 0 <= time - self._time < _CHECK_PERIOD:
            return False
        self._time = time
        settled = self._is_settled()  # also notes where the vertices are
        still = (
            settled
            and gas_is_still
            and time > self._after
            and not self._is_near()
            and not self._pushes.any()
        )
        moved = self._is_moved()  # also notes where the frame is
        self._calm = self._calm + 1 if still and not moved else 0
        return self._calm >= _TIMES

    def sleep(self) -> None:
        model = self._model
        self._kept = tuple(part.copy() for part in (*self._collision(), self._springs))
        for part in self._collision():
            part[:] = 0
        bodies = model.geom_bodyid[self._sample]
        # contacts are listed, but exert no force yet
        model.geom_gap[self._sample] = model.body_margin[bodies] = self._margin
        model.geom_conaffinity[self._sample] = model.body_conaffinity[bodies] = ANYTHING
        model.flex_rigid[self._flex] = True
        self._springs[:] = self._load.displacements
        model.jnt_stiffness[self._joints, ...] = _STIFFNESS
        self._data.qvel[self._load.dofs] = 0.0
        self._load.suspend()
        self._time = float(self._data.time)
        self.asleep = True

    def wake(self) -> None:
        """Restore the state before sleep; vertices moved in between stay."""
        model = self._model
        if np.abs(self._load.displacements - self._springs).max() <= 1e-6:
            self._load.displacements[:] = self._springs
            self._data.qvel[self._load.dofs] = 0.0
        for part, kept in zip((*self._collision(), self._springs), self._kept, strict=True):
            part[:] = kept
        model.flex_rigid[self._flex] = False
        model.jnt_stiffness[self._joints, ...] = 0.0
        self._load.resume()
        self.asleep = False
        self.stay_awake()

    def stay_awake(self) -> None:
        """Reset the time without motion, because the state is about to change."""
        self._after = float(self._data.time) + _HOLD
        self._calm = 0

    def _undo(self) -> None:
        """Undo changes of the model by another run time's sleep."""
        model = self._model
        model.geom_gap[self._geoms] = model.body_margin[self._bodies] = 0.0
        # the geoms' own and the flex's: `touch_with`
        model.body_conaffinity[self._bodies] = ANYTHING
        self._springs[:] = 0.0
        model.flex_rigid[self._flex] = False
        model.jnt_stiffness[self._joints, ...] = 0.0
        self._load.resume()

    def _collision(self) -> tuple[Array, ...]:
        """Return views of the model's values that set the membrane's contacts."""
        model = self._model
        geoms = self._geoms
        bodies = self._bodies
        flex = slice(self._flex, self._flex + 1)
        return (
            model.geom_gap[geoms],
            model.body_margin[bodies],
            model.geom_conaffinity[geoms],
            model.body_conaffinity[bodies],
            model.flex_conaffinity[flex],
        )

    def _is_settled(self) -> bool:
        """Return True if the vertices have not moved since the last check."""
        now = self._load.displacements.copy()
        before = self._before
        self._before = now
        return np.abs(now - before).max() < max(STILL * np.abs(now).max(), STILL_MIN)

    def _is_near(self) -> bool:
        contact = self._data.contact
        if not len(contact.dist):
            return False
        geom = contact.geom
        return bool(
            (((geom >= self._first) & (geom <= self._last)) | (contact.flex == self._flex)).any()
        )

    def _is_moved(self) -> bool:
        """Return True if the frame accelerates, rotates, or has tilted since the last call or
        sleep."""
        option = self._model.opt
        velocity = self._data.cvel[self._body].tolist()
        axes = self._data.xmat[self._body].tolist()
        g = option.gravity.tolist()
        minimum = SHAKEN * option.timestep
        weight = [axes[k] * g[0] + axes[3 + k] * g[1] + axes[6 + k] * g[2] for k in range(3)]
        before = self._velocity
        self._velocity = velocity
        known = self._weight
        self._weight = self._weight if self.asleep else weight
        return (
            any(abs(velocity[k] - before[k]) > minimum for k in (3, 4, 5))
            or any(abs(v) > _TURNING for v in velocity[:3])
            or not all(abs(a - b) < SHAKEN for a, b in zip(weight, known, strict=True))
        )
