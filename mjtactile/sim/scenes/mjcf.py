"""Reader of MJCF files from any source."""

from __future__ import annotations

import contextlib
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.rig.domain_randomization import ObjectChange
from mjtactile.sim.scenes import mjcf_trial

LARGEST = 32 << 20  # bytes
COPIES_MAX = 20_000
"""Maximum number of copies of elements in a file."""
_PARSED_MAX = 1 << 20  # maximum size of a file that this process parses, bytes
_COPIES = ("replicate", "composite", "flexcomp")


def read_mjcf(path: Path, text: str = "", field: str | None = None) -> mujoco.MjSpec:
    """Return the specification of the file, or of `text` if it is not empty.

    Raises InputError that names `field` for invalid MJCF, too many elements, and a file that
    needs too much memory or time (`mjtactile.sim.scenes.mjcf_trial`).
    """
    try:
        if text:
            _require_few_copies(path, _root(text), field)
            return mujoco.MjSpec.from_string(text)
        _require_bounded(path, field)
        return mujoco.MjSpec.from_file(str(path))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path, field=field) from error
    except (ValueError, RuntimeError) as error:
        raise InputError(
            f"not valid MJCF: {' '.join(str(error).split())}", source=path, field=field
        ) from error


def _require_bounded(path: Path, field: str | None) -> None:
    """Raise InputError for a file that is too large, or needs too much memory or time."""
    root = None
    content = foreign_file.read_bytes(path, LARGEST, "an MJCF file", field)
    if len(content) <= _PARSED_MAX:
        root = _root(content.decode("utf-8-sig", errors="replace"))
        _require_few_copies(path, root, field)
    if reason := mjcf_trial.refusal(path, root):
        raise InputError(reason, source=path, field=field)


def _root(text: str) -> ElementTree.Element | None:
    """Return the root of the XML text; None for invalid XML, which MuJoCo reports better."""
    with contextlib.suppress(ElementTree.ParseError):
        return ElementTree.fromstring(text)
    return None


def _require_few_copies(path: Path, root: ElementTree.Element | None, field: str | None) -> None:
    waiting = [] if root is None else [(root, 1)]
    while waiting:
        element, copies = waiting.pop()
        if element.tag in _COPIES:
            copies *= _count(element.get("count", "1"))
            if copies > COPIES_MAX:
                raise InputError(
                    f"makes {copies} copies; at most {COPIES_MAX} are allowed",
                    source=path,
                    field=field or element.tag,
                )
        waiting += [(child, copies) for child in element]


def _count(text: str) -> int:
    """Return the product of the integers in the text; 1 if it does not consist of integers."""
    try:
        return math.prod(max(int(word), 1) for word in text.split())
    except ValueError:
        return 1


def changed_options(spec: mujoco.MjSpec) -> list[str]:
    """Return the names of the options that differ from MuJoCo's defaults."""
    default = mujoco.MjSpec().option
    return [name for name in _option_names() if not _is_equal(spec.option, default, name)]


def take_options(part: mujoco.MjSpec, scene: mujoco.MjSpec) -> None:
    """Set the scene's options in `part`, before it is attached to `scene`.

    They apply anyway; MuJoCo warns about every difference.
    """
    part.memory = scene.memory
    for name in _option_names():
        if not _is_equal(part.option, scene.option, name):
            setattr(part.option, name, getattr(scene.option, name))


def _option_names() -> list[str]:
    return [name for name in dir(mujoco.MjSpec().option) if not name.startswith("_")]


def _is_equal(a: object, b: object, name: str) -> bool:
    return np.array_equal(getattr(a, name), getattr(b, name))


def change(spec: mujoco.MjSpec, changes: ObjectChange) -> None:
    """Apply `changes` to a parsed file.

    Size scales all elements about the file's origin. Mass and stiffness apply to movable parts. The
    mass grows with the volume; springs keep their stiffness.
    """
    _scale(spec, 1 + changes.size)
    if changes.mass or changes.size:
        density = 1 + changes.mass
        _weigh(spec, (1 + changes.size) ** 3 * density, density, (1 + changes.size) ** 2)
    for geom in [*spec.geoms, *spec.flexes]:
        geom.friction = np.asarray(geom.friction) * [1 + changes.friction, 1.0, 1.0]
    for joint in spec.joints:
        joint.stiffness = np.asarray(joint.stiffness) * (1 + changes.stiffness)
    for flex in spec.flexes:
        flex.young *= 1 + changes.stiffness


def _scale(spec: mujoco.MjSpec, size: float) -> None:
    if size == 1:
        return
    bodies = [body for body in spec.bodies if body.name != "world"]
    for element in [*bodies, *spec.geoms, *spec.sites, *spec.joints, *spec.frames]:
        element.pos = size * np.asarray(element.pos)
    for element in [*spec.geoms, *spec.sites]:
        element.size = size * np.asarray(element.size)
        element.fromto = size * np.asarray(element.fromto)
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
        flex.vert = [size * value for value in flex.vert]
        flex.node = [size * value for value in flex.node]
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
