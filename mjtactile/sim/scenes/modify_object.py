"""Changes to an object's MJCF: size, mass, friction and stiffness."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from mjtactile.rig.domain_randomization import ObjectChange


def change(spec: mujoco.MjSpec, changes: ObjectChange) -> None:
    """Apply `changes` to a parsed file.

    Size scales all elements about the file's origin. Mass and stiffness apply to movable parts. The
    mass grows with the volume; springs keep their stiffness.
    """
    _scale(spec, 1 + changes.size)
    if changes.mass or changes.size:
        _weigh(
            spec,
            (1 + changes.size) ** 3 * (1 + changes.mass),
            1 + changes.mass,
            (1 + changes.size) ** 2,
        )
    for geom in [*spec.geoms, *spec.flexes]:
        geom.friction = np.asarray(geom.friction) * [1 + changes.friction, 1.0, 1.0]
    for joint in spec.joints:
        joint.stiffness = np.asarray(joint.stiffness) * (1 + changes.stiffness)
    for flex in spec.flexes:
        flex.young *= 1 + changes.stiffness


def _scale(spec: mujoco.MjSpec, size: float) -> None:
    if size == 1:
        return
    for thing in [
        *(body for body in spec.bodies if body.name != "world"),
        *spec.geoms,
        *spec.sites,
        *spec.joints,
        *spec.frames,
    ]:
        thing.pos = size * np.asarray(thing.pos)
    for thing in [*spec.geoms, *spec.sites]:
        thing.size = size * np.asarray(thing.size)
        thing.fromto = size * np.asarray(thing.fromto)
    for body in spec.bodies:
        body.ipos = size * np.asarray(body.ipos)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            joint.range = size * np.asarray(joint.range)
            joint.ref = size * joint.ref
            joint.springref = size * joint.springref
    for mesh in spec.meshes:
        mesh.scale = size * np.asarray(mesh.scale)
    for flex in spec.flexes:
        flex.vert = _times(flex.vert, size)
        flex.node = _times(flex.node, size)
        flex.radius *= size


def _weigh(spec: mujoco.MjSpec, mass: float, density: float, square: float) -> None:
    """Scale given masses by `mass`, densities by `density`, and inertias by `mass` times
    `square`."""
    for geom in spec.geoms:
        if math.isnan(geom.mass):
            geom.density *= density
        else:
            geom.mass *= mass
    for body in spec.bodies:
        if body.explicitinertial:
            body.mass *= mass
            body.inertia = mass * square * np.asarray(body.inertia)
            body.fullinertia = mass * square * np.asarray(body.fullinertia)


def _times(values: Any, factor: float) -> list[float]:
    return [factor * value for value in values]
