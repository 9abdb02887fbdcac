"""Estimate of a run's discretization error from a second simulation of the same contact.

The second simulation uses a coarser mesh and a longer time step (step doubling in both). The
membrane converges with second order in the mesh width. With a width ratio r, the error of the
coarse run is r^2 times that of the fine run. The fine run's error is the difference of both divided
by r^2 - 1 (Richardson 1911; Roache, Verification and Validation, 1998). The estimate excludes
errors common to both runs: the material law, and the camera.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mjtactile.core.errors import SimulationError
from mjtactile.core.types import Array
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.grasp_world import GraspWorld

RATIO = 1.5  # ratio of mesh widths, coarse over fine
_LONGEST_STEP = 8e-3  # maximum time step, s
_FREE = 0.04  # additional opening for the inflation of both membranes, m
# Durations, s
_CLOSING = 0.4
_RESTING = 0.3


def coarser(mesh: tuple[int, int], timestep: float) -> tuple[tuple[int, int], float]:
    """Return a mesh with `RATIO` times the cell width, and up to twice the time step.

    Vertex counts stay odd, so that the center stays a vertex.
    """

    def fewer(count: int) -> int:
        return max(7, 2 * round((count - 1) / RATIO / 2) + 1)

    return (fewer(mesh[0]), fewer(mesh[1])), min(2 * timestep, _LONGEST_STEP)


def richardson(
    fine: float, coarse: float, mesh: tuple[int, int], coarse_mesh: tuple[int, int]
) -> float:
    """Return the estimated error of `fine`, N; NaN for equal meshes.

    It follows from the two forces and the actual ratio of the mesh widths.
    """
    ratio = ((mesh[0] - 1) * (mesh[1] - 1) / ((coarse_mesh[0] - 1) * (coarse_mesh[1] - 1))) ** 0.5
    return abs(fine - coarse) / (ratio**2 - 1) if ratio > 1 else float("nan")


def press_errors(
    press: Callable[[tuple[int, int], float], list[dict[str, Any]]],
    steps: list[dict[str, Any]],
    mesh: tuple[int, int],
    timestep: float,
) -> list[float]:
    """Return the estimated error, N, of every step's `force_true_N`.

    `press` runs the same plan with another mesh and time step.
    """
    coarse_mesh, coarse_step = coarser(mesh, timestep)
    others = press(coarse_mesh, coarse_step)
    return [
        richardson(
            float(np.linalg.norm(a["force_true_N"])),
            float(np.linalg.norm(b["force_true_N"])),
            mesh,
            coarse_mesh,
        )
        for a, b in zip(steps, others, strict=True)
    ]


class GraspEstimate:
    """Discretization error of the contact force in a grasp.

    The grasp is repeated on two meshes. Both repetitions start from the inflated, untouched
    membranes. They move jaws and object to their poses in the run, so the results differ by the
    discretization only.
    """

    def __init__(self, world: GraspWorld):
        self._world = world
        self._state: tuple[Array, Array, float] | None = None

    def keep(self) -> None:
        """Store the current pose of object and gripper. Call while the object is held."""
        joint = self._object_joint(self._world)
        qpos = np.array(self._world.data.qpos[joint : joint + 7])
        self._state = qpos, np.array([self._world.lift_height]), self._world.opening

    def force_error(self) -> float:
        """Estimate the error of the normal force on a finger, N.

        It is NaN if no state was stored or a repetition failed.
        """
        if self._state is None:
            return float("nan")
        mesh = self._world.sensors[0].mesh
        fine = mesh.nx, mesh.ny
        coarse, step = coarser(fine, self._world.timestep)
        try:
            forces = [self._repeat(fine, self._world.timestep), self._repeat(coarse, step)]
        except SimulationError:
            return float("nan")
        return richardson(forces[0], forces[1], fine, coarse)

    def _repeat(self, mesh: tuple[int, int], timestep: float) -> float:
        """Compute the mean normal force on both membranes with all rigid parts held in position,
        N."""
        assert self._state is not None
        old = self._world
        pose, lift, opening = self._state
        start = min(opening + _FREE, old.max_opening)
        world = GraspWorld(
            old.design,
            old.object,
            rig=old.rig,
            timestep=timestep,
            mesh=mesh,
            opening=start,
            effects=old.effects,
            as_built_designs=old.as_built_designs,
        )
        for i in range(len(world.sensors)):
            world.sensors[i].open_valve()
        self._drive(world, pose, lift, np.full(round(0.15 / timestep), start))
        for i in range(len(world.sensors)):
            world.sensors[i].close_valve()
        self._drive(world, pose, lift, np.linspace(start, opening, round(_CLOSING / timestep)))
        self._drive(world, pose, lift, np.full(round(_RESTING / timestep), opening))
        return float(
            np.mean([-ground_truth.contact_force(world, i)[2] for i in range(len(world.sensors))])
        )

    def _drive(self, world: GraspWorld, pose: Array, lift: Array, openings: Array) -> None:
        """Step the world, and correct the poses of the rigid parts before every step."""
        joint = self._object_joint(world)
        model = world.model
        data = world.data
        dof = int(model.jnt_dofadr[model.jnt_qposadr.tolist().index(joint)])
        for opening in openings:
            data.qpos[joint : joint + 7] = pose
            data.qvel[dof : dof + 6] = 0.0
            world.place_gripper(float(opening), float(lift[0]))
            world.step()

    @staticmethod
    def _object_joint(world: GraspWorld) -> int:
        """Return the address of the object's free joint in qpos."""
        body = world.model.body("object/object")
        return int(world.model.jnt_qposadr[body.jntadr[0]])
