"""Initial states of grasps: the worlds that `mjtactile evaluate` builds for the same seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
import warp as wp

from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import SampledTask, load_task
from mjtactile.core.types import Array
from mjtactile.rig.as_built_sensor import AsBuiltSensor
from mjtactile.rig.domain_randomization import NONE, SampledWorld, load_variation
from mjtactile.rig.finger import Rig
from mjtactile.sim.fast_reset import object_roots, planar_pose
from mjtactile.sim.rig import object_in_task, place, start_of, strength_in_task
from mjtactile.sim.scenes.disturbances import ROTATION_MAX, static_bodies
from mjtactile.sim.scenes.initial_state import path_axes
from mjtactile.sim.scenes.objects import PREFIX
from mjtactile.warp.arrays import floats, ints
from mjtactile.warp.as_built_membranes import match_membranes
from mjtactile.warp.device.disturbances import COLUMNS, KINDS, VALUES
from mjtactile.warp.device.restart import Starts
from mjtactile.warp.object_mix import MixedObject, objects_of, poses_of

# parameters of a variation that have an effect here; those of the camera are in the error model
SUPPORTED = {
    "object": ("size_percent", "mass_percent", "friction_percent", "breaking_percent", "place_mm",
               "yaw_deg"),
    "sensor": ("stiffness_percent", "thickness_percent", "pre_stretch_offset",
               "friction_percent"),
    "rig": ("delay_ms", "jitter_ms", "backlash_mm", "speed_percent", "force_noise_N"),
}  # fmt: skip
_SEEN = ("fx_percent", "center_px", "k1_offset", "k1", "camera_shift_mm", "camera_tilt_deg",
         "blur_px", "noise_percent", "light_percent", "marker_radius_um",
         "missing_markers")  # fmt: skip


@dataclass(frozen=True)
class SampledStarts:
    """Device arrays of the initial states of `seeds`, with the seeds (rows,).

    `kinds` (rows,) are the numbers of the objects. `events` (rows, n, COLUMNS) are the disturbances
    of `mjtactile.warp.device.disturbances`.
    """

    starts: Any
    seeds: Array
    kinds: Array
    events: Any


def ignored_parameters(randomization: str) -> list[str]:
    """Return the parameters of a variation that have no effect here."""
    if randomization == NONE:
        return []
    found = []
    for name in load_variation(randomization).spreads:
        section, _, key = name.partition(".")
        is_seen = section == "camera" or (section == "sensor" and key in _SEEN)
        if not is_seen and key not in SUPPORTED.get(section, ()):
            found.append(name)
    return found


def sample_starts(
    scenario: Scenario, rig: Rig, mix: Sequence[MixedObject], seeds: Sequence[int], worlds: int
) -> SampledStarts:
    """Sample the initial states of `seeds` of a scenario, built once as `rig`.

    Seed s has the object s modulo the number of objects in `mix`. Meshes keep their size in a batch
    of several objects.

    Raises InputError for a size that an object's meshes cannot take, or a delay that exceeds the
    camera period.
    """
    world = rig.scene
    kinds = np.array(seeds) % len(mix)
    objects = [mix[k].grasped for k in kinds]
    fingers = [finger.name for finger in rig.fingers]
    task = load_task(scenario.task)
    tasks = [task.sample(seed, len(fingers)) for seed in seeds]
    sampled = _sampled_worlds(scenario, rig, mix, kinds, seeds, tasks)
    _check(sampled, mix, rig.period)
    changed = [
        strength_in_task(grasped.changed(one.object), task, in_task, len(fingers))
        for one, in_task, grasped in zip(sampled, tasks, objects, strict=True)
    ]
    poses = [place(one, start_of(seed)[0]) for one, seed in zip(changed, seeds, strict=True)]
    scale = np.array([1 + item.object.size for item in sampled])
    starts = Starts()
    starts.kind, starts.scale = ints(kinds), floats(scale)
    free = _add_bodies(starts, world, mix, kinds, poses, scale, start_of(scenario.seed)[0])
    _add_values(starts, rig, sampled, fingers)
    starts.break_force = floats(np.minimum([item.break_force for item in changed], 1e6))
    main = world.model.body(f"{PREFIX}object").id
    own = starts.objects.ipos.numpy()[kinds, free.index(main), 2] if main in free else 0.0
    center = scale * own  # the object stands upright, or has its center there
    heights = starts.free.numpy()[:, free.index(main), 2] + center if main in free else center
    starts.rest_height = floats(heights)
    starts.pulls = floats([task.pulls() for task in tasks])
    starts.episode = wp.zeros(worlds, dtype=int)
    starts.row = wp.zeros(worlds, dtype=int)
    return SampledStarts(
        starts, np.asarray(seeds), kinds, floats(_events(tasks, path_axes(world.start)))
    )


def _sampled_worlds(
    scenario: Scenario,
    rig: Rig,
    mix: Sequence[MixedObject],
    kinds: Array,
    seeds: Sequence[int],
    tasks: Sequence[SampledTask],
) -> list[SampledWorld]:
    """Sample the randomized values of each seed, with the object as the task has it."""
    fingers = [finger.name for finger in rig.fingers]
    design = rig.fingers[0].design
    variation = load_variation(scenario.randomization)
    sampled = []
    for seed, kind, in_task in zip(seeds, kinds, tasks, strict=True):
        one = variation.sample(seed, fingers=fingers, markers=design.markers.count)
        if len(mix) > 1 and mix[kind].model.nmesh:
            one = replace(one, object=replace(one.object, size=0.0))
        changed = object_in_task(one.object, in_task, mix[kind].grasped, design)
        sampled.append(replace(one, object=changed))
    return sampled


def _add_bodies(
    starts: Any,
    world: Any,
    mix: Sequence[MixedObject],
    kinds: Array,
    poses: Sequence[tuple[float, float, float]],
    scale: Array,
    start: tuple[float, float, float],
) -> list[int]:
    """Add the bodies and geoms of objects and supports with their poses; return the free bodies."""
    model = world.model
    roots = object_roots(model)
    free = [body for body in roots if model.body_jntnum[body]]
    fixed = [body for body in roots if not model.body_jntnum[body]]
    supports = [body for body in static_bodies(model).tolist() if body not in roots]
    starts.free_bodies, starts.fixed_bodies = ints(free), ints([*fixed, *supports])
    on_fixed = np.isin(model.body_rootid[model.geom_bodyid], [*fixed, *supports])
    starts.fixed_geoms = ints(np.flatnonzero(on_fixed))
    starts.address = ints([model.jnt_qposadr[model.body_jntadr[body]] for body in free])
    starts.dof = ints([model.body_dofadr[body] for body in free])
    geoms = [g for g in range(model.ngeom) if model.body_rootid[model.geom_bodyid[g]] in roots]
    starts.geoms = ints(geoms)
    starts.objects = objects_of(model, mix, geoms, free)
    for name, bodies, others in (("free", free, []), ("fixed", fixed, supports)):
        table = np.zeros((len(kinds), max(len(bodies) + len(others), 1), 7))
        local = _local(world, mix, bodies, start)
        for b in range(len(bodies)):
            table[:, b] = _world_poses(local[kinds, b], poses, scale, world)
        for b, body in enumerate(others, len(bodies)):
            table[:, b] = [*model.body_pos[body], *model.body_quat[body]]
        setattr(starts, name, floats(table))
    return free


def _add_values(
    starts: Any, rig: Rig, sampled: Sequence[SampledWorld], fingers: Sequence[str]
) -> None:
    """Add the state of the rig, and the sampled values of object, membranes and gripper."""
    world = rig.scene
    starts.qpos, starts.ctrl = floats(world.data.qpos), floats(world.data.ctrl)
    starts.opening, starts.force = float(world.opening), float(rig.limits.force)
    starts.mass = floats([1 + item.object.mass for item in sampled])
    starts.friction = floats([_frictions(item, fingers) for item in sampled])
    sensor = world.sensors[0]
    stiffness = np.array([_finger_values(item, fingers, _stiffness) for item in sampled])
    offsets = np.array([_finger_values(item, fingers, _pre_stretch) for item in sampled])
    found = match_membranes(
        sensor.design, (sensor.mesh.nx, sensor.mesh.ny), stiffness.ravel(), offsets.ravel()
    )
    starts.modulus, starts.volume = (floats(item.reshape(stiffness.shape)) for item in found)
    speed = world.rig.gripper.speed
    starts.rig = floats(
        [(c.delay, c.jitter, c.backlash, (1 + c.speed) * speed, c.force_noise)
         for c in (item.rig for item in sampled)]
    )  # fmt: skip


def _events(tasks: Sequence[SampledTask], axes: Array) -> Array:
    """Return the disturbances of each world as rows. Their directions are along `axes` in W."""
    table = np.zeros((len(tasks), max(1, *(len(task.events) for task in tasks)), COLUMNS))
    table[:, :, 0], table[:, :, 2] = -1, 1
    for rows, task in zip(table, tasks, strict=True):
        for row, event in zip(rows, task.events, strict=False):
            values = [event.values.get(name, 0.0) for name in VALUES[event.kind]]
            row[:3] = KINDS.index(event.kind), event.start, event.duration
            row[3 : 3 + len(values)] = values
            row[6:9], row[9] = np.array(event.direction) @ axes, event.finger or 0
            if event.kind == "shake":
                row[5] = min(row[5], ROTATION_MAX)
    return table


def _check(sampled: Sequence[SampledWorld], mix: Sequence[MixedObject], period: float) -> None:
    longest = max(world.rig.delay + world.rig.jitter for world in sampled)
    if longest > period:
        text = f"delays of up to {1e3 * longest:.0f} ms exceed the period of {1e3 * period:.0f} ms"
        raise InputError(text, source="Grasp-v0", field="randomization")
    model = mix[0].model
    roots = object_roots(model)
    kinds = {
        int(model.geom_type[g])
        for g in range(model.ngeom)
        if model.body_rootid[model.geom_bodyid[g]] in roots
    }
    if int(mujoco.mjtGeom.mjGEOM_MESH) in kinds and any(world.object.size for world in sampled):
        text = "object.size_percent cannot change a mesh while it runs"
        raise InputError(text, source="Grasp-v0", field="randomization")


def _local(
    world: Any, mix: Sequence[MixedObject], bodies: Sequence[int], start: tuple[float, float, float]
) -> Array:
    """Return the poses (K, bodies, 7) of an object's bodies on the table, in its file's axes."""
    model, data = world.model, world.data
    names = [model.body(body).name.removeprefix(PREFIX) for body in bodies]
    if len(mix) > 1:
        poses = poses_of(mix, names)
        poses[:, :, 2] += world.rig.table_height
        return poses
    yaw = world.start.yaw
    centre = np.array([*world.start.centre[:2], 0.0])
    R, p = planar_pose(place(world.object, start), yaw, centre)
    back = np.zeros(4)
    mujoco.mju_mat2Quat(back, R.T.ravel())
    poses = np.zeros((1, len(bodies), 7))
    for b, body in enumerate(bodies):
        joint = int(model.body_jntadr[body])
        at = data.qpos[model.jnt_qposadr[joint] :] if joint >= 0 else model.body_pos[body]
        rotation = at[3:7] if joint >= 0 else model.body_quat[body]
        poses[0, b, :3] = R.T @ (at[:3] - p)
        mujoco.mju_mulQuat(poses[0, b, 3:], back, rotation)
    return poses


def _world_poses(
    local: Array, requested: Sequence[tuple[float, float, float]], scale: Array, world: Any
) -> Array:
    """Return a body's poses (n, 7) in the world from its `local` poses (n, 7)."""
    yaw = world.start.yaw
    centre = np.array([*world.start.centre[:2], 0.0])
    table = world.rig.table_height
    moved = np.zeros((len(requested), 7))
    for k, mask in enumerate(requested):
        R, p = planar_pose(mask, yaw, centre)
        at = scale[k] * (local[k, :3] - [0, 0, table]) + [0, 0, table]
        quaternion, result = np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, R.ravel())
        mujoco.mju_mulQuat(result, quaternion, np.ascontiguousarray(local[k, 3:]))
        moved[k] = [*(R @ at + p), *result]
    return moved


def _frictions(world: SampledWorld, fingers: Sequence[str]) -> list[float]:
    """Return the relative friction of the object's geoms, and of it with each membrane."""
    factor = 1 + world.object.friction
    return [factor, *(factor * (1 + world.as_built_sensor(f).friction_fraction) for f in fingers)]


def _finger_values(
    world: SampledWorld, fingers: Sequence[str], value: Callable[[AsBuiltSensor], float]
) -> list[float]:
    """Return a value of each finger's as-built sensor."""
    return [value(world.as_built_sensor(finger)) for finger in fingers]


def _stiffness(built: AsBuiltSensor) -> float:
    return (1 + built.stiffness_fraction) * (1 + built.thickness_fraction)


def _pre_stretch(built: AsBuiltSensor) -> float:
    return built.pre_stretch


def with_seed(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario of an episode without its randomization, which `sample_starts` adds."""
    return replace(scenario, seed=seed, randomization=NONE, effects="-mesh,-pipeline", task="lift")
