"""What films do to a scene: their forces in MuJoCo's `qfrc_applied`, beside what a user writes
there, and damping of the bodies that they hold.

A film's force is computed from where things are, and acts until they are somewhere else. That alone
is stable for sqrt(k / m) h < 2. Bodies that are free are therefore damped against the motion that
they have against the films, by half of what the films' stiffness adds over a step; MuJoCo takes
damping of joints implicitly, with which any stiffness is stable (decision 32).
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass

import mujoco
import numpy as np

from mjtactile.core.types import Array

_SHARE = 0.5  # of stiffness times step; the least with which every step is stable


@dataclass(frozen=True, eq=False)
class Hold:
    """How one film holds a free body: the address of its joint, `stiffness` (6, 6) by its degrees
    of freedom, and their `velocity` (6,) against the film."""

    dof: int
    stiffness: Array
    velocity: Array


class Pushes:
    """What all films of one `data` add; made by `pushes_of`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self._model = model
        self._data = data
        self._step = float(model.opt.timestep)
        self._parts: dict[str, tuple[Array, Hold | None]] = {}
        self._base = data.qfrc_applied.copy()
        self._left = data.qfrc_applied.copy()
        self._damping = model.dof_damping.copy()
        self._damped: set[int] = set()

    def set(self, owner: str, force: Array, hold: Hold | None) -> None:
        """Add `force` (nv,) and damping from now on, in place of what `owner` added before.

        What somebody else has written to `qfrc_applied` since is theirs, and stays.
        """
        applied = self._data.qfrc_applied
        if not np.array_equal(applied, self._left):
            self._base = applied.copy()
        self._parts[owner] = (force, hold)
        total = self._base.copy()
        for one, _ in self._parts.values():
            total += one
        self._damp(total)
        applied[:] = total
        self._left = total

    def _damp(self, total: Array) -> None:
        """Damp the bodies that are held, and add to `total` what damping takes from a motion that
        goes with the films."""
        model = self._model
        damping = model.dof_damping
        for dof in self._damped:
            damping[dof : dof + 6] = self._damping[dof : dof + 6]
        holds = [hold for _, hold in self._parts.values() if hold is not None]
        self._damped = {hold.dof for hold in holds}
        for dof in self._damped:
            mine = [hold for hold in holds if hold.dof == dof]
            # at least the stiffness, by Gershgorin in coordinates with an inertia of one
            inertia = np.sqrt(model.dof_M0[dof : dof + 6])
            stiff = np.abs(sum(hold.stiffness for hold in mine))
            most = _SHARE * self._step * (stiff / inertia).sum(axis=1) * inertia
            against = sum(hold.velocity for hold in mine) / len(mine)
            damping[dof : dof + 6] += most
            total[dof : dof + 6] += most * (self._data.qvel[dof : dof + 6] - against)


_known: weakref.WeakValueDictionary[int, Pushes] = weakref.WeakValueDictionary()


def pushes_of(model: mujoco.MjModel, data: mujoco.MjData) -> Pushes:
    """The one `Pushes` of `data`, which lives as long as somebody keeps it."""
    found = _known.get(id(data))
    if found is None or found._data is not data:
        found = _known[id(data)] = Pushes(model, data)
    return found
