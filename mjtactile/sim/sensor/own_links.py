"""Links of the robot next to a sensor, whose contacts with its membrane do not count.

MuJoCo's filters compare bodies. The sensor is a part of the link that carries it, but a vertex of
the mesh is a body of its own, so that the filter of parent and child does not apply to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.sim.sensor.feature_size import weld_bodies
from mjtactile.sim.sensor.membrane import RESERVED


def own_links(model: mujoco.MjModel, body: int) -> NDArray[np.int64]:
    """Return the MuJoCo bodies (n,) whose contacts with the sensor's `body` do not count.

    The sensor's link turns on theirs, as in MuJoCo's parent-child filter, or they carry it by
    other joints and an `<exclude>` names both. A palm on which the link slides counts: the sensor
    moves into it. Links that the sensor's link carries do count: a press moves its indenter
    relative to the sensor. Other fingers count, too: robots exclude them since their pads overlap
    when the gripper is closed.
    """
    welds = weld_bodies(model)
    link = welds[body]
    # as MuJoCo's filter: mocap bodies are fixed to the world, which is no link
    fixed = np.asarray(model.body_weldid)
    link_body = fixed[body]
    joints = model.jnt_type[model.jnt_bodyid == link_body]
    turns = bool((joints != int(mujoco.mjtJoint.mjJNT_SLIDE)).any())
    above = fixed[model.body_parentid[link_body]] if link_body and turns else 0
    neighbors = (fixed == above) & (above != 0)
    signatures = np.asarray(model.exclude_signature, np.int64)
    pairs = np.stack([signatures >> 16, signatures & 0xFFFF], axis=1)
    named = np.unique(pairs[(welds[pairs] == link).any(axis=1)])
    carrying = [each for each in named if welds[each] != link and _carries(model, each, body)]
    return np.union1d(np.flatnonzero(neighbors), np.array(carrying, np.int64))


def _carries(model: mujoco.MjModel, part: int, body: int) -> bool:
    """Return True if `body` is below `part`, or below a body that `part` is fixed to."""
    above = set()
    while body:
        body = int(model.body_parentid[body])
        above.add(body)
    while part and part not in above and not model.body_jntnum[part]:
        part = int(model.body_parentid[part])
    return part != 0 and part in above


def exclude_from_elements(model: mujoco.MjModel, body: int, flex: int) -> None:
    """Exclude contacts of the membrane's triangles with the bodies that `own_links` returns.

    MuJoCo does not apply `<exclude>` to a flex. The geoms of these bodies get `contype` bits of
    their own, which all others take over in their `conaffinity` except for this flex.

    Args:
        model: Compiled scene; its contact bits are changed.
        body: Body of the sensor.
        flex: Flex of the membrane.

    Raises:
        InputError: A scene that uses all bits.
    """
    mine = np.isin(model.geom_bodyid, own_links(model, body))
    for contype in np.unique(model.geom_contype[mine & (model.geom_contype != 0)]).tolist():
        same = mine & (model.geom_contype == contype)
        bit = contype
        if (model.geom_contype[~same] & contype).any() or (model.flex_contype & contype).any():
            bit = _unused_bit(model)
            for affinity in (
                model.geom_conaffinity,
                model.body_conaffinity,
                model.flex_conaffinity,
            ):
                affinity[:] = np.where(affinity & contype, affinity | bit, affinity & ~bit)
            model.geom_contype[same] = bit
            model.body_contype[model.geom_bodyid[same]] |= bit
        model.flex_conaffinity[flex] &= ~bit


def _unused_bit(model: mujoco.MjModel) -> int:
    """Return a bit that is in no `contype` of the scene."""
    used = np.bitwise_or.reduce(
        np.concatenate([model.geom_contype, model.flex_contype, [RESERVED]])
    )
    for number in range(30):
        if not used & (1 << number):
            return 1 << number
    raise InputError(
        "the scene uses all contype bits, but contact 'elements' needs one for the links next to "
        "the sensor: free a bit, or use contact 'vertices'",
        source="bind",
        field="contact",
    )


def exclude_own_links(
    spec: mujoco.MjSpec, carrier: mujoco.MjsBody, vertices: Sequence[str]
) -> None:
    """Exclude contacts of the mesh's `vertices` with the bodies that `own_links` returns.

    Args:
        spec: Scene with the sensor.
        carrier: Body of the sensor's site.
        vertices: Names of the bodies of the vertices.
    """
    link = _moving(carrier)
    if link.parent is None:
        return
    above = _moving(link.parent)
    turns = any(joint.type != mujoco.mjtJoint.mjJNT_SLIDE for joint in link.joints)
    fixed = _fixed_to(above) if turns and above.parent is not None else []
    mine = {body.name for body in _fixed_to(link)} - {""}
    carrying = {part.name for each in _above(link) for part in _fixed_to(each)}
    pairs = [{pair.bodyname1, pair.bodyname2} for pair in spec.excludes]
    named = set().union(*(pair - mine for pair in pairs if pair & mine)) & carrying
    for number, body in enumerate(fixed):
        body.name = body.name or f"{vertices[0]}_link{number}"
    for other in {body.name for body in fixed} | named:
        for vertex in vertices:
            spec.add_exclude(bodyname1=vertex, bodyname2=other)


def _moving(body: mujoco.MjsBody) -> mujoco.MjsBody:
    """Return the first body with joints from `body` up to the world, or the world."""
    while body.parent is not None and not list(body.joints):
        body = body.parent
    return body


def _above(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    """Return the bodies that carry `body`, without the world."""
    parent = body.parent
    return [] if parent is None or parent.parent is None else [parent, *_above(parent)]


def _fixed_to(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    """Return `body` and the bodies below it that no joint moves relative to it."""
    return [body, *(b for child in body.bodies if not list(child.joints) for b in _fixed_to(child))]
