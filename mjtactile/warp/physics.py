"""Membranes of a scene with their contact memory: one step, at the poses of the scene or near."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from mjtactile.core.types import Array
from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.gas import Gas, Heat
from mjtactile.warp.device.sticking import Sticking
from mjtactile.warp.device.update import States, update_all
from mjtactile.warp.membranes import Iteration, Membranes, new_scheme

_STATE = {"fields": Fields, "gas": Gas, "heat": Heat, "states": States, "sticking": Sticking}
_NOWHERE = np.zeros(6)


@dataclass(frozen=True, eq=False)
class Physics:
    """Membranes on the geoms of a scene.

    `fields`, `gas`, `heat`, `states` and `sticking` hold the state. The others are constants.
    """

    membranes: Membranes
    scheme: Any
    sticking: Any
    sensor_geoms: Any
    fields: Any
    gas: Any
    heat: Any
    states: Any

    def update(self, m: Any, d: Any, twist: Array = _NOWHERE) -> None:
        """Find the equilibria and the friction on the poses of a scene.

        Args:
            m: Model of MuJoCo Warp.
            d: Data of MuJoCo Warp.
            twist: (6,) Shift, m, and rotation about the origin, rad, of all obstacles in S.
        """
        part = self.membranes
        wp.launch_tiled(
            update_all,
            dim=[part.count],
            inputs=[
                *(part.rubber, self.scheme, self.gas, self.heat, self.sticking, self.sensor_geoms),
                *(self.states, part.geoms, part.pool, part.modulus, self.fields, m.geom_size),
                *(d.xpos, d.xmat, d.geom_xpos, d.geom_xmat),
                *(wp.vec3(*twist[:3]), wp.mat33(*_rotation(twist[3:]).ravel())),
            ],
            block_dim=part.block,
        )

    def copy(self, iteration: Iteration) -> Physics:
        """Return a copy with its own state, and another iteration."""
        state = {name: _copy(kind, getattr(self, name)) for name, kind in _STATE.items()}
        return replace(self, scheme=new_scheme(self.membranes.membrane, iteration), **state)

    def assign(self, other: Physics) -> None:
        """Copy the state of `other`."""
        for name, kind in _STATE.items():
            _assign(kind, getattr(self, name), getattr(other, name))


def _assign(kind: Any, to: Any, source: Any) -> None:
    for name, variable in kind.vars.items():
        if isinstance(variable.type, wp.array):
            wp.copy(getattr(to, name), getattr(source, name))
        elif hasattr(variable.type, "vars"):  # a struct
            _assign(variable.type, getattr(to, name), getattr(source, name))


def _copy(kind: Any, source: Any) -> Any:
    made = kind()
    for name, variable in kind.vars.items():
        value = getattr(source, name)
        if isinstance(variable.type, wp.array):
            value = wp.clone(value)
        elif hasattr(variable.type, "vars"):
            value = _copy(variable.type, value)
        setattr(made, name, value)
    return made


def _rotation(turn: Array) -> Array:
    """Return the rotation (3, 3) by a rotation vector (3,), rad."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    return Rotation.from_rotvec(turn).as_matrix() if np.any(turn) else np.eye(3)
