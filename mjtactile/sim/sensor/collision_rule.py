"""MuJoCo's collision rule for the membranes of a user's scene.

Two geoms touch if the `contype` of one shares a bit with the `conaffinity` of the other. A membrane
touches any `contype`, but has none of its own: membranes and their vertices would touch each other.
A geom that a default geom touches only by its own `conaffinity` therefore gets a reserved `contype`
bit, which no other geom has in its `conaffinity`. So does a geom without bits that has a `<pair>`
with a geom of the sensor's carrier. An `<exclude>` of the carrier does not apply to its sensor.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.sim.sensor.feature_size import name_of, weld_bodies
from mjtactile.sim.sensor.membrane import RESERVED

_MARGIN = 1e-3  # m; published scenes have up to this
_NAMED = 5  # geoms listed in a note
_DEFAULT = 1  # contype of a geom without one in its MJCF


def apply_collision_rule(model: mujoco.MjModel, carrier: int) -> None:
    """Enable contacts of membranes with the geoms and flexes that would touch a default geom, and
    with those in a `<pair>` with a geom of the body `carrier`."""
    for contype, conaffinity in (
        (model.geom_contype, model.geom_conaffinity),
        (model.flex_contype, model.flex_conaffinity),
    ):
        others = (conaffinity & RESERVED) == 0
        contype[others & (contype == 0) & ((conaffinity & _DEFAULT) != 0)] = RESERVED
    model.geom_contype[_paired_with(model, carrier)] = RESERVED
    bodies = model.geom_bodyid[model.geom_contype == RESERVED]
    model.body_contype[bodies] |= RESERVED


def pair_only_geoms(model: mujoco.MjModel, carrier: int) -> NDArray[np.int64]:
    """Return the geoms (n,) that make contact by a `<pair>` only and are not fixed to `carrier`."""
    paired = np.unique([model.pair_geom1, model.pair_geom2]).astype(np.int64)
    silent = (model.geom_contype[paired] == 0) & (model.geom_conaffinity[paired] == 0)
    return paired[silent & ~_is_fixed_to(model, carrier)[paired]]


def contact_notes(model: mujoco.MjModel, carrier: int) -> list[str]:
    """Return notes on the `<pair>`s, `<exclude>`s, margins and gaps of a scene that do not apply to
    the sensor as to a rigid geom."""
    notes = []
    silent = pair_only_geoms(model, carrier)
    if len(silent):
        names = ", ".join(repr(name_of(model, int(geom))) for geom in silent)
        notes.append(
            f"{names} makes contact by <pair> only and goes through the membrane: set its contype "
            "to 1"
        )
    excluded = _excluded_with(model, carrier)
    if excluded:
        names = ", ".join(repr(model.body(body).name or f"body {body}") for body in excluded)
        notes.append(
            f"<exclude> of the carrier and {names} does not apply to the sensor, which touches it: "
            "set contype and conaffinity of its geoms to 0 if it must not"
        )
    early = _with_margin_or_gap(model, carrier)
    if len(early):
        names = ", ".join(repr(name_of(model, int(geom))) for geom in early[:_NAMED])
        more = ", ..." if len(early) > _NAMED else ""
        notes.append(
            f"{names}{more} has a margin or a negative gap: on a mesh its contacts begin in front "
            "of or behind its surface, without a mesh at its surface: set both to 0"
        )
    return notes


def _with_margin_or_gap(model: mujoco.MjModel, carrier: int) -> NDArray[np.int64]:
    """Return the geoms (n,) of other objects whose margin or gap moves their contacts."""
    moves = (model.geom_margin > _MARGIN) | (model.geom_gap < 0)
    other = model.body_rootid[model.geom_bodyid] != model.body_rootid[carrier]
    other |= model.geom_bodyid == 0
    touches = (model.geom_contype != 0) & ((model.geom_conaffinity & RESERVED) == 0)
    return np.flatnonzero(moves & other & touches)


def _is_fixed_to(model: mujoco.MjModel, carrier: int) -> NDArray[np.bool_]:
    """Return True for each geom (ngeom,) that is fixed to the body `carrier`."""
    welds = weld_bodies(model)
    return welds[model.geom_bodyid] == welds[carrier]


def _paired_with(model: mujoco.MjModel, carrier: int) -> NDArray[np.int64]:
    """Return the geoms (n,) without bits that have a `<pair>` with a geom of `carrier`."""
    pairs = np.array([model.pair_geom1, model.pair_geom2], np.int64).reshape(2, -1)
    mine = _is_fixed_to(model, carrier)[pairs]
    others = pairs[::-1][mine & ~mine[::-1]]
    silent = (model.geom_contype[others] == 0) & (model.geom_conaffinity[others] == 0)
    return np.unique(others[silent])


def _excluded_with(model: mujoco.MjModel, carrier: int) -> list[int]:
    """Return the bodies of other objects, not of the robot, that are excluded with `carrier`."""
    signature = np.asarray(model.exclude_signature, np.int64)
    pairs = np.array([signature >> 16, signature & 0xFFFF])
    welds = weld_bodies(model)
    mine = welds[pairs] == welds[carrier]
    others = pairs[::-1][mine & ~mine[::-1]]
    return sorted({int(b) for b in others if model.body_rootid[b] != model.body_rootid[carrier]})
