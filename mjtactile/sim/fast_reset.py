"""Restart of a simulated rig from a snapshot, with its object at another position.

The snapshot holds MuJoCo's data and model arrays and every mutable attribute of the run-time
objects. Arrays are restored in place. Views of them and addresses held by kernels stay valid.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.rig.finger import Rig
from mjtactile.sim.rig import place, start_of
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.objects import PREFIX
from mjtactile.sim.scenes.world import World


class Snapshot:
    """The state of `world`, and of the other objects that belong to it, now."""

    def __init__(self, world: World, *others: Any):
        self._world = world
        self._data = copy.copy(world.data)
        self._undo: list[Callable[[], None]] = []
        self._seen: set[int] = {id(world.model), id(world.data)}
        for name in dir(world.model):
            if not name.startswith("_") and isinstance(getattr(world.model, name), np.ndarray):
                self._keep_array(getattr(world.model, name))
        for item in (world, *others):
            self._keep(item)

    def restore(self) -> None:
        """Restore the stored state. The world must be paused."""
        mujoco.mj_copyData(self._world.data, self._world.model, self._data)
        for undo in self._undo:
            undo()

    def _keep(self, item: Any) -> None:
        """Record the undo action that restores `item` and its contents to the current state."""
        if id(item) in self._seen:
            return
        if isinstance(item, np.ndarray):
            self._keep_array(item)
        elif isinstance(item, np.random.Generator):
            self._seen.add(id(item))
            state = copy.deepcopy(item.bit_generator.state)
            self._undo.append(lambda: setattr(item.bit_generator, "state", copy.deepcopy(state)))
        elif isinstance(item, (list, deque, dict, set)):
            self._keep_container(item)
        elif isinstance(item, tuple):
            for part in item:
                self._keep(part)
        elif type(item).__module__.startswith("mjtactile.") and hasattr(item, "__dict__"):
            self._keep_object(item)

    def _keep_array(self, array: np.ndarray) -> None:
        self._seen.add(id(array))
        if not array.flags.writeable or array.dtype == object:
            return
        was = array.copy()
        self._undo.append(lambda: np.copyto(array, was))

    def _keep_container(self, item: Any) -> None:
        self._seen.add(id(item))
        was = item.copy()

        def undo() -> None:
            item.clear()
            item.update(was) if isinstance(item, (dict, set)) else item.extend(was)

        self._undo.append(undo)
        for part in was.values() if isinstance(was, dict) else was:
            self._keep(part)

    def _keep_object(self, item: Any) -> None:
        self._seen.add(id(item))
        was = dict(vars(item))

        def undo() -> None:
            vars(item).clear()
            vars(item).update(was)

        self._undo.append(undo)
        for value in was.values():
            self._keep(value)


class Restart:
    """Snapshot of the state of `rig`, built with `seed`, before anything touched the object.

    Raises InputError for a rig or object that cannot be reset; see `movable`.
    """

    def __init__(self, rig: Rig, seed: int):
        world = rig.scene
        if not movable(world):
            raise InputError(
                "a soft or jointed object, or one with loose geoms, cannot be moved without "
                "a new model",
                source=world.object.path,
                field="object",
            )
        self._rig = rig
        self._world = world
        self._pose = place(world.object, start_of(seed)[0])
        self._snapshot = Snapshot(world, rig.gripper, rig.clock, *rig.cameras, *rig.valves)

    def again(self, seed: int) -> None:
        """Reset the rig with a new seed: object pose, and noise of its devices."""
        self._snapshot.restore()
        pose, seeds = start_of(seed)
        self._move(place(self._world.object, pose))
        for camera, seed_of_camera in zip(
            self._rig.cameras, seeds(len(self._rig.cameras)), strict=True
        ):
            camera.reseed(seed_of_camera)  # pyright: ignore[reportAttributeAccessIssue] it is a SimCamera
        for k, valve in enumerate(self._rig.valves):
            valve.reseed(seed + k)  # pyright: ignore[reportAttributeAccessIssue] it is a SimValve
        self._rig.gripper.reseed(seed)  # pyright: ignore[reportAttributeAccessIssue]

    def _move(self, pose: tuple[float, float, float]) -> None:
        """Move all MuJoCo bodies of the object's file together, relative to the gripper's axes."""
        world = self._world
        model = world.model
        data = world.data
        yaw = world.start.yaw
        centre = np.array([*world.start.centre[:2], 0.0])
        R_old, p_old = planar_pose(self._pose, yaw, centre)
        R_new, p_new = planar_pose(pose, yaw, centre)
        R = R_new @ R_old.T
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, R.ravel())
        for body in object_roots(model):
            joint = int(model.body_jntadr[body])
            if joint >= 0:  # free
                at = int(model.jnt_qposadr[joint])
                where = data.qpos[at : at + 3]
                turned = data.qpos[at + 3 : at + 7]
                dof = int(model.jnt_dofadr[joint])
                data.qvel[dof : dof + 3] = R @ data.qvel[dof : dof + 3]
            else:
                where = model.body_pos[body]
                turned = model.body_quat[body]
            where[:] = R @ (where - p_old) + p_new
            result = np.zeros(4)
            mujoco.mju_mulQuat(result, quaternion, turned)
            turned[:] = result
        mujoco.mj_forward(model, data)


def movable(world: GraspWorld) -> bool:
    """Return True if all parts of the object are fixed or free MuJoCo bodies in the world."""
    model = world.model
    if not isinstance(world, GraspWorld) or world.solid is not None or model.nmocap:
        return False
    in_world = [model.geom(g).name for g in range(model.ngeom) if model.geom_bodyid[g] == 0]
    joints = [int(model.body_jntadr[body]) for body in object_roots(model)]
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    return not any(name.startswith(PREFIX) for name in in_world) and all(
        joint < 0 or model.jnt_type[joint] == free for joint in joints
    )


def object_roots(model: mujoco.MjModel) -> list[int]:
    """Return the MuJoCo bodies of the object's file that are direct children of the world."""
    return [
        body
        for body in range(1, model.nbody)
        if model.body_parentid[body] == 0 and model.body(body).name.startswith(PREFIX)
    ]


def planar_pose(pose: tuple[float, float, float], yaw: float, centre: Array) -> tuple[Array, Array]:
    """Return rotation (3, 3) and position (3,), m, in W, of the object file's world at `pose`."""
    x, y, angle = pose
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    c = math.cos(yaw + angle)
    s = math.sin(yaw + angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), centre + [
        cos * x - sin * y,
        sin * x + cos * y,
        0.0,
    ]
