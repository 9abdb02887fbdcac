"""MuJoCo's collision rule for the membranes of a user's scene.

Two geoms touch if the `contype` of one shares a bit with the `conaffinity` of the other. A membrane
touches any `contype`, but has none of its own: membranes and their vertices would touch each other.
A geom that a default geom touches only by its own `conaffinity` therefore gets a reserved `contype`
bit, which no other geom has in its `conaffinity`.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.sim.sensor.feature_size import name_of
from mjtactile.sim.sensor.membrane import ANYTHING

RESERVED = 1 << 30
"""Bit of `contype` that only membranes and their housings have in their `conaffinity`."""
_DEFAULT = 1  # contype of a geom without one in its MJCF


def apply_collision_rule(model: mujoco.MjModel) -> None:
    """Let membranes touch the geoms and flexes that have `conaffinity` 1 but no `contype`."""
    for contype, conaffinity in (
        (model.geom_contype, model.geom_conaffinity),
        (model.flex_contype, model.flex_conaffinity),
    ):
        others = conaffinity != ANYTHING
        contype[others & (contype == 0) & ((conaffinity & _DEFAULT) != 0)] = RESERVED
    bodies = model.geom_bodyid[model.geom_contype == RESERVED]
    model.body_contype[bodies] |= RESERVED


def pair_notes(model: mujoco.MjModel) -> list[str]:
    """Return a note if geoms make contact by a `<pair>` only: no membrane touches them."""
    paired = np.unique([model.pair_geom1, model.pair_geom2])
    silent = (model.geom_contype[paired] == 0) & (model.geom_conaffinity[paired] == 0)
    if not silent.any():
        return []
    names = ", ".join(repr(name_of(model, int(geom))) for geom in paired[silent])
    return [
        f"{names} makes contact by <pair> only and goes through the membrane: set its contype to 1"
    ]
