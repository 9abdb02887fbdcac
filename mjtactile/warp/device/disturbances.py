"""Disturbances of the held objects in all worlds, as `mjtactile.sim.scenes.disturbances`."""

from __future__ import annotations

import warp as wp

from mjtactile.sim.scenes import disturbances
from mjtactile.warp.device.gripper import Drive, height_of
from mjtactile.warp.device.restart import Poses, Scene, Starts, place_fixed
from mjtactile.warp.device.task_score import TaskState

wp.set_module_options({"enable_backward": False})

FILL = wp.constant(0)
FRICTION = wp.constant(1)
SHAKE = wp.constant(2)
PUSH = wp.constant(3)
MOVE_SUPPORT = wp.constant(4)
PULL = wp.constant(5)
KINDS = ("fill", "friction", "shake", "push", "move_support", "pull")
COLUMNS = 10
"""Kind, start s, duration s, three values, direction (3,), finger from 1 (0: all).

The values are those of `VALUES`; a row of kind -1 is empty.
"""
VALUES = {
    "fill": ("mass",),
    "friction": ("friction",),
    "shake": ("acceleration", "rate", "tilt"),
    "push": ("impulse",),
    "move_support": ("height",),
    "pull": ("force",),
}
_TAKEN_TIME = wp.constant(disturbances.TAKEN_TIME)


@wp.func
def _ramp(final: float, now: float, fraction: float) -> float:
    return now + (final - now) * fraction


@wp.func
def _shaken(
    gravity: wp.vec3,
    way: wp.vec3,
    acceleration: float,
    rate: float,
    tilt: float,
    time: float,
    fraction: float,
) -> wp.vec3:
    """Return gravity in a gripper that moves along a direction and tilts, with smooth ends."""
    swell = wp.sqrt(wp.sin(wp.pi * fraction))
    moved = gravity + swell * acceleration * wp.sin(2.0 * wp.pi * rate * time) * way
    axis = wp.cross(wp.vec3(0.0, 0.0, 1.0), way)
    length = wp.length(axis)
    if length > 1.0e-6:
        rotation = wp.quat_from_axis_angle(axis / length, tilt * swell)
        moved = wp.quat_rotate(rotation, moved)
    return moved


@wp.func
def _fill(starts: Starts, scene: Scene, world: int, row: int, mass: float, fraction: float) -> None:
    """Change mass and inertia of the object towards a total of `mass` kg."""
    s = starts.scale[row]
    k = starts.kind[row]
    first = starts.mass[row] * s * s * s
    total = float(0.0)
    for b in range(starts.free_bodies.shape[0]):
        total += first * starts.objects.mass[k, b]
    ratio = 1.0 + (mass / total - 1.0) * fraction
    for b in range(starts.free_bodies.shape[0]):
        body = starts.free_bodies[b]
        scene.body_mass[world, body] = ratio * first * starts.objects.mass[k, b]
        scene.body_subtreemass[world, body] = ratio * first * starts.objects.mass[k, b]
        scene.body_inertia[world, body] = ratio * first * s * s * starts.objects.inertia[k, b]


@wp.func
def _pull(
    task: TaskState,
    starts: Starts,
    scene: Scene,
    wrench: wp.array2d(dtype=float),
    velocity: wp.array2d(dtype=wp.spatial_vector),
    gravity: wp.vec3,
    fingers: int,
    w: int,
    force: wp.vec3,
) -> wp.vec3:
    """Return a pull; an object that has left the grip is held in place."""
    touches = int(0)
    for k in range(fingers):
        if wrench[w * fingers + k, 2] < 0.0:
            touches += 1
    if touches < wp.min(2, fingers):
        task.taken[w] = 1
    found = force
    if task.taken[w] != 0:
        found = wp.vec3(0.0, 0.0, 0.0)
        for b in range(starts.free_bodies.shape[0]):
            body = starts.free_bodies[b]
            speed = wp.spatial_bottom(velocity[w, body])
            found -= scene.body_mass[w, body] * (gravity + speed / _TAKEN_TIME)
    return found


@wp.kernel
def disturb_worlds(
    fingers: int,
    up: float,
    gravity: wp.vec3,
    events: wp.array3d(dtype=float),
    starts: Starts,
    scene: Scene,
    drive: Drive,
    membrane_friction: wp.array(dtype=float),
    time: wp.array(dtype=float),
    qpos: wp.array2d(dtype=float),
    task: TaskState,
    poses: Poses,
    wrench: wp.array2d(dtype=float),
    velocity: wp.array2d(dtype=wp.spatial_vector),
    world_gravity: wp.array(dtype=wp.vec3),
    xfrc: wp.array2d(dtype=wp.spatial_vector),
):
    """Set masses, friction, gravity and forces of the coming step.

    Times count from the end of the lift: from a height of `up` m.
    """
    world = wp.tid()
    row = starts.row[world]
    if task.up_since[world] < 0.0 and height_of(drive, qpos, world) >= up:
        task.up_since[world] = time[world]
    force = wp.vec3(0.0, 0.0, 0.0)
    turned = gravity
    if task.up_since[world] >= 0.0:
        since = time[world] - task.up_since[world]
        smallest = float(1.0e6)
        for k in range(fingers):
            f = world * fingers + k
            friction = scene.membrane_friction * starts.friction[row, 1 + k]
            for e in range(events.shape[1]):
                x = wp.clamp((since - events[row, e, 1]) / events[row, e, 2], 0.0, 1.0)
                finger = int(events[row, e, 9])
                if int(events[row, e, 0]) == FRICTION and (finger == 0 or finger == k + 1):
                    friction = _ramp(events[row, e, 3], friction, x)
            membrane_friction[f] = friction
            smallest = wp.min(smallest, friction)
        for g in range(starts.geoms.shape[0]):
            geom = starts.geoms[g]
            compiled = scene.friction[geom]
            surface = wp.min(starts.friction[row, 0] * compiled[0], smallest)
            scene.geom_friction[world, geom] = wp.vec3(surface, compiled[1], compiled[2])
        for e in range(events.shape[1]):
            kind = int(events[row, e, 0])
            passed = since - events[row, e, 1]
            x = wp.clamp(passed / events[row, e, 2], 0.0, 1.0)
            direction = wp.vec3(events[row, e, 6], events[row, e, 7], events[row, e, 8])
            if x > 0.0 and kind == FILL:
                _fill(starts, scene, world, row, events[row, e, 3], x)
            if x > 0.0 and x < 1.0 and kind == SHAKE:
                turned = _shaken(
                    turned,
                    direction,
                    events[row, e, 3],
                    events[row, e, 4],
                    events[row, e, 5],
                    passed,
                    x,
                )
            if x > 0.0 and x < 1.0 and kind == PUSH:
                force += events[row, e, 3] / events[row, e, 2] * direction
            if x > 0.0 and kind == PULL:
                pull = events[row, e, 3] * x * direction
                now = world_gravity[world]
                force += _pull(task, starts, scene, wrench, velocity, now, fingers, world, pull)
            if x > 0.0 and kind == MOVE_SUPPORT:
                task.rise[world] = events[row, e, 3] * x
                place_fixed(starts, scene, poses, world, row, task.rise[world])
    world_gravity[world] = turned
    total = float(0.0)
    for b in range(starts.free_bodies.shape[0]):
        total += scene.body_mass[world, starts.free_bodies[b]]
    for b in range(starts.free_bodies.shape[0]):
        body = starts.free_bodies[b]
        part = scene.body_mass[world, body] / total * force
        xfrc[world, body] = wp.spatial_vector(part, wp.vec3(0.0, 0.0, 0.0))
