"""Random objects of several kinds in one batch, as a union of their geoms.

MuJoCo Warp has one type of each geom in all worlds. The union has the largest number of geoms of
each type that an object has. A mesh that a world's object does not have is absent, a geom of
another type is tiny and far away.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import warp as wp

from mjtactile.core.types import Array
from mjtactile.sim.scenes.objects import PREFIX, ObjectModel, load_object, read_spec
from mjtactile.sim.scenes.random_objects import random_object
from mjtactile.warp.arrays import floats, vectors
from mjtactile.warp.device.restart import Objects

COUNT = 256
"""Objects of a batch."""
FIRST = 1_000_000
"""Seed of the first object; those of `evaluate` are smaller."""
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_FAR = [0.0, 0.0, 1e3]  # position of an absent geom, m
_TINY = 1e-6  # its size, m

Slot = tuple[str, int, int, int, int]
"""Body, geom type, contype, conaffinity, and number among the geoms of these."""


@dataclass(frozen=True, eq=False)
class MixedObject:
    """Object of a batch: its seed, and its compiled model alone."""

    seed: int
    grasped: ObjectModel
    model: mujoco.MjModel


@lru_cache(maxsize=1)
def random_mix() -> tuple[MixedObject, ...]:
    """Return the first `COUNT` rigid random objects from `FIRST` on."""
    found: list[MixedObject] = []
    seed = FIRST
    while len(found) < COUNT:
        if random_object(seed).shape != "fruit":  # jointed
            grasped = load_object(f"random:{seed}")
            found.append(MixedObject(seed, grasped, read_spec(grasped).compile()))
        seed += 1
    return tuple(found)


def slots_of(model: mujoco.MjModel, prefix: str = "") -> Iterator[tuple[Slot, int]]:
    """Yield the slot and the number of each geom of an object's bodies."""
    seen: Counter[tuple[str, int, int, int]] = Counter()
    for geom in range(model.ngeom):
        name = model.body(int(model.geom_bodyid[geom])).name
        if name.startswith(prefix) and model.geom_bodyid[geom]:
            masks = int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
            key = (name.removeprefix(prefix), int(model.geom_type[geom]), *masks)
            yield (*key, seen[key]), geom
            seen[key] += 1


def write_mix(mix: Sequence[MixedObject], path: Path) -> None:
    """Write the union of the objects as the file of one object, in the pose of the first."""
    spec = mujoco.MjSpec()
    union = sorted({slot for item in mix for slot, _ in slots_of(item.model)})
    for name in sorted({slot[0] for slot in union}):
        body = spec.worldbody.add_body(name=name)
        if name == "object":
            body.add_freejoint()
            body.pos = [0.0, 0.0, mix[0].grasped.grasp_height]
            body.mass, body.inertia, body.explicitinertial = 0.02, [2e-6] * 3, True
    names = []
    for item in mix:
        for mesh in read_spec(item.grasped).meshes:
            names.append(f"mesh{item.seed}")
            spec.add_mesh(name=names[-1], uservert=mesh.uservert)
    for name, kind, contype, conaffinity, index in union:
        geom = spec.body(name).add_geom(
            name=f"{name}_{kind}_{contype}_{index}",
            type=kind,
            contype=contype,
            conaffinity=conaffinity,
            friction=[0.3, 0.005, 0.0001],
            size=[5e-3, 5e-3, 5e-3],
        )
        if kind == _MESH:
            geom.meshname = names[0]
    spec.add_numeric(name="break_force_N", data=[1.0], size=1)
    spec.add_numeric(name="grasp_height_m", data=[mix[0].grasped.grasp_height], size=1)
    spec.add_text(name="material", data="solid")
    spec.compile()
    path.write_text(spec.to_xml())


def single(world: Any) -> tuple[MixedObject, ...]:
    """Return the object of a world as the only one."""
    return (MixedObject(-1, world.object, world.model),)


def objects_of(
    model: mujoco.MjModel, mix: Sequence[MixedObject], geoms: Sequence[int], free: Sequence[int]
) -> Any:
    """Return the values of all objects for the `geoms` and `free` bodies of a scene's model."""
    found, bodies = _matches(model, mix, geoms, free)

    def of_geoms(name: str, absent: Any) -> Array:
        return np.array(
            [
                [getattr(item.model, name)[g] if g >= 0 else absent for g in row]
                for item, row in zip(mix, found, strict=True)
            ]
        )

    def of_bodies(name: str) -> Array:
        return np.array(
            [getattr(item.model, name)[row] for item, row in zip(mix, bodies, strict=True)]
        )

    def quaternions(values: Array) -> Any:
        return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.quat)

    objects = Objects()
    objects.size = vectors(of_geoms("geom_size", [_TINY] * 3))
    objects.pos = vectors(of_geoms("geom_pos", _FAR))
    objects.quat = quaternions(of_geoms("geom_quat", [1.0, 0.0, 0.0, 0.0]))
    objects.rbound = floats(of_geoms("geom_rbound", _TINY))
    boxes = of_geoms("geom_aabb", [0.0, 0.0, 0.0, _TINY, _TINY, _TINY])
    objects.box = vectors(boxes.reshape(*boxes.shape[:2], 2, 3))
    objects.mesh = wp.array(_meshes(model, mix, found), dtype=int)
    objects.mass = floats(of_bodies("body_mass"))
    objects.inertia = vectors(of_bodies("body_inertia"))
    objects.ipos = vectors(of_bodies("body_ipos"))
    objects.iquat = quaternions(of_bodies("body_iquat"))
    objects.lightness = wp.array(of_bodies("body_invweight0").astype(np.float32), dtype=wp.vec2)
    dofs = [[item.model.body_dofadr[b] for b in row] for item, row in zip(mix, bodies, strict=True)]
    objects.diagonal = floats(
        [[item.model.dof_M0[d : d + 6] for d in row] for item, row in zip(mix, dofs, strict=True)]
    )
    objects.rise = floats([item.grasped.grasp_height - mix[0].grasped.grasp_height for item in mix])
    return objects


def _matches(
    model: mujoco.MjModel, mix: Sequence[MixedObject], geoms: Sequence[int], free: Sequence[int]
) -> tuple[list[list[int]], list[list[int]]]:
    """Return each object's geoms (-1: absent) and bodies for those of a scene's model."""
    slots = {geom: slot for slot, geom in slots_of(model, PREFIX)}
    found, bodies = [], []
    for item in mix:
        prefix = PREFIX if item.model is model else ""
        table = dict(slots_of(item.model, prefix))
        found.append([table.get(slots[geom], -1) for geom in geoms])
        names = [model.body(b).name.removeprefix(PREFIX) for b in free]
        bodies.append([item.model.body(prefix + name).id for name in names])
    return found, bodies


def _meshes(model: mujoco.MjModel, mix: Sequence[MixedObject], found: Sequence[Any]) -> Array:
    """Return the index (K, geoms) of each mesh in the scene's model, or -1."""
    mesh_ids = np.full((len(mix), len(found[0])), -1, np.int32)
    for k, (item, row) in enumerate(zip(mix, found, strict=True)):
        for g, geom in enumerate(row):
            if geom >= 0 and item.model.geom_dataid[geom] >= 0:
                if item.model is model:
                    mesh_ids[k, g] = model.geom_dataid[geom]
                else:
                    mesh_ids[k, g] = model.mesh(f"{PREFIX}mesh{item.seed}").id
    return mesh_ids


def poses_of(mix: Sequence[MixedObject], bodies: Sequence[str]) -> Array:
    """Return the poses (K, bodies, 7) in the files of the objects. Absent bodies are at 0."""
    poses = np.zeros((len(mix), len(bodies), 7))
    poses[:, :, 3] = 1.0
    for k, item in enumerate(mix):
        names = [item.model.body(b).name for b in object_roots_alone(item.model)]
        for b, name in enumerate(bodies):
            if name in names:
                body = item.model.body(name).id
                poses[k, b] = [*item.model.body_pos[body], *item.model.body_quat[body]]
    return poses


def object_roots_alone(model: mujoco.MjModel) -> list[int]:
    """Return the direct children of the world in an object's model alone."""
    return [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
