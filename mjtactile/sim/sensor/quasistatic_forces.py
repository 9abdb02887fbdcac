"""What films do to a scene: their forces in MuJoCo's `qfrc_applied`, beside what a user writes
there, and damping of the bodies that they hold.

A film's force is computed from where things are, and acts until they are somewhere else. That alone
is stable for sqrt(k / m) h < 2. Bodies that are free are therefore damped against the motion that
they have against the films, by half of what the films' stiffness adds over a step; MuJoCo takes
damping of joints implicitly, with which any stiffness is stable (decision 32).
"""

from __future__ import annotations

import weakref

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.kernels import bound, words

HOLD = 43
"""Numbers that say how a free body is held: its joint, stiffness (6, 6) and velocity (6,)."""


class QuasistaticForces:
    """What all films of one `data` add; made by `pushes_of`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self._model = model
        self._data = data
        self._owners: list[str] = []
        self._forces = np.zeros((0, model.nv))
        self._holds = np.zeros((0, HOLD))
        self._base = data.qfrc_applied.copy()
        self._left = data.qfrc_applied.copy()
        self._undamped = model.dof_damping.copy()
        self._add = None

    def join(self, owner: str) -> int:
        """The number of `owner`'s row; one that comes again has its old one, emptied."""
        if owner not in self._owners:
            self._owners.append(owner)
            self._forces = np.vstack([self._forces, np.zeros((1, self._model.nv))])
            self._holds = np.vstack([self._holds, np.zeros((1, HOLD))])
            self._bind()
        number = self._owners.index(owner)
        self._forces[number] = self._holds[number] = 0.0
        return number

    def set(self, number: int, force: Array, hold: Array) -> None:
        """Add `force` (nv,) from now on, and damping of the body of `hold` (HOLD,), in place of
        what that row added before.

        What somebody else has written to `qfrc_applied` since is theirs, and stays.
        """
        self._forces[number] = force
        self._holds[number] = hold
        assert self._add is not None
        self._add()

    def words(self) -> Array:
        """(12,) What `film_add` is called with; good until another joins."""
        assert self._add is not None
        return words(self._add)

    def addresses(self, number: int) -> list[int]:
        """Of what a row adds: its force and its hold."""
        return [rows[number].ctypes.data for rows in (self._forces, self._holds)]

    def _bind(self) -> None:
        model = self._model
        data = self._data
        self._add = bound(
            "film_add",
            model.nv,
            len(self._owners),
            self._forces,
            self._holds,
            float(model.opt.timestep),
            model.dof_M0,
            data.qvel,
            self._base,
            self._left,
            data.qfrc_applied,
            self._undamped,
            model.dof_damping.reshape(-1),
        )


_known: weakref.WeakValueDictionary[int, QuasistaticForces] = weakref.WeakValueDictionary()


def pushes_of(model: mujoco.MjModel, data: mujoco.MjData) -> QuasistaticForces:
    """The one `QuasistaticForces` of `data`, which lives as long as somebody keeps it."""
    found = _known.get(id(data))
    if found is None or found._data is not data:
        found = _known[id(data)] = QuasistaticForces(model, data)
    return found
