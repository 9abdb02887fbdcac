"""Forces of quasi-static membranes in MuJoCo's `qfrc_applied`, and damping.

A membrane's force is computed from the present poses and stays constant during the step. That alone
is stable for sqrt(k / m) h < 2. Free MuJoCo bodies are therefore damped against their motion
relative to the membranes, by half of the force that the membranes' stiffness adds over a step.
MuJoCo treats joint damping implicitly, which makes any stiffness stable (decision 32).
"""

from __future__ import annotations

import weakref

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.kernels import bound, words

HOLD = 43
"""Number of values of a held free MuJoCo body: joint, stiffness (6, 6) and velocity (6,)."""


class QuasistaticForces:
    """Sum of forces and damping of the quasi-static membranes of one `data`; see `pushes_of`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self._model = model
        self._data = data
        self._owners: list[str] = []
        self._forces = np.zeros((0, 2, model.nv))  # force; damping of inner joints
        self._holds = np.zeros((0, HOLD))
        self._rows: list[slice] = []  # of `_holds`, by owner
        self._base = data.qfrc_applied.copy()
        self._left = data.qfrc_applied.copy()
        self._undamped = model.dof_damping.copy()
        self._add = None

    def join(self, owner: str, count: int) -> int:
        """Return the row index of `owner`, whose membrane may touch `count` bodies.

        A known owner gets its previous row, set to zero.
        """
        if owner not in self._owners:
            first = len(self._holds)
            self._owners.append(owner)
            self._rows.append(slice(first, first + count))
            self._forces = np.vstack([self._forces, np.zeros((1, 2, self._model.nv))])
            self._holds = np.vstack([self._holds, np.zeros((count, HOLD))])
            self._bind()
        index = self._owners.index(owner)
        self._forces[index] = 0.0
        self._holds[self._rows[index]] = 0.0
        return index

    def set(self, index: int, force: Array, holds: Array) -> None:
        """Set row `index` to `force` (2, nv), which is force and damping of inner joints, and the
        damping of the MuJoCo bodies of `holds` (count, HOLD). Other changes to `qfrc_applied` are
        kept."""
        self._forces[index] = force
        self._holds[self._rows[index]] = holds
        assert self._add is not None
        self._add()

    def words(self) -> Array:
        """Return the arguments (13,) of `qs_add`; valid until another owner joins."""
        assert self._add is not None
        return words(self._add)

    def addresses(self, index: int) -> list[int]:
        """Return the memory addresses of a row's force and of its holds."""
        holds = self._holds[self._rows[index]]
        return [self._forces[index].ctypes.data, holds.ctypes.data]

    def _bind(self) -> None:
        model, data = self._model, self._data
        rows = (model.nv, len(self._owners), self._forces, len(self._holds), self._holds)
        damping = (self._undamped, model.dof_damping.reshape(-1))
        self._add = bound(
            "qs_add",
            *(*rows, float(model.opt.timestep), model.dof_M0, data.qvel),
            *(self._base, self._left, data.qfrc_applied, *damping),
        )


_known: weakref.WeakValueDictionary[int, QuasistaticForces] = weakref.WeakValueDictionary()


def pushes_of(model: mujoco.MjModel, data: mujoco.MjData) -> QuasistaticForces:
    """Return the single `QuasistaticForces` of `data`, which exists as long as it is referenced."""
    found = _known.get(id(data))
    if found is None or found._data is not data:
        found = _known[id(data)] = QuasistaticForces(model, data)
    return found
