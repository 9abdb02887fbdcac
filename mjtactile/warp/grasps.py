"""`Grasps`: many grasps of a policy on one device, with the steps of `mjtactile/Grasp-v0`.

A control step is one camera period. Policy, gripper, membranes, estimates and score stay on the
device; nothing waits for the host. On a GPU the physics of a control step is one CUDA graph.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from mjtactile.core import policy
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import load_task
from mjtactile.core.task_sections import SuccessCriteria
from mjtactile.core.types import Array
from mjtactile.rig.domain_randomization import NONE
from mjtactile.sim.rig import build_sim_rig
from mjtactile.sim.scenes.disturbances import UP
from mjtactile.sim.scenes.objects import PREFIX
from mjtactile.sim.sensing_error_model import load_errors
from mjtactile.warp.arrays import zeros_of
from mjtactile.warp.device.disturbances import disturb_worlds
from mjtactile.warp.device.grasp_phase import Commands, command_all, measure_all, observe_all
from mjtactile.warp.device.grasp_score import OUTCOMES, Scores, finish_step, score_step
from mjtactile.warp.device.gripper import Goals, drive_grippers
from mjtactile.warp.device.restart import Poses, restart_worlds
from mjtactile.warp.device.sensing_errors import Estimates, estimate_all
from mjtactile.warp.device.task_score import TaskState, score_task
from mjtactile.warp.grasp_setup import (
    criteria_of,
    drive_of,
    error_model,
    limits_of,
    require_supported,
    scene_of,
)
from mjtactile.warp.object_mix import random_mix, single, write_mix
from mjtactile.warp.scene import bind_bodies
from mjtactile.warp.starts import sample_starts, with_seed

RANDOM = "random"
"""Object name for different random objects in one batch."""
EPISODES = 4
"""Different initial states of each world. The fifth episode starts like the first."""
_CPU_ITERATIONS = 30
"""Iterations of MuJoCo's solver on a CPU, which always does all. A grasp needs ten."""


class Grasps:
    """One grasp in each of `worlds` worlds.

    Arrays on the device, with one row for each world: `observation` (worlds, 8 fingers + 14),
    `scores` (outcome, reward, terminated, truncated and ground truth), `touch`.
    """

    def __init__(
        self,
        scenario: Scenario,
        worlds: int,
        *,
        rewards: dict[str, float],
        progress: Sequence[tuple[float, float]] = (),
        time_limit: float = 20.0,
        nodes: tuple[int, int] | None = None,
        timestep: float | None = None,
        device: str | None = None,
    ):
        """Build the worlds; `reset` starts them.

        Args:
            scenario: Object, sensor, rig, task and randomization; its effects are not used. Object
                `RANDOM`: those of `random_mix`.
            worlds: Number of worlds.
            rewards: Reward of each outcome, at the end of an episode.
            progress: Start and increase of the reward of each phase; empty: only `rewards` count.
            time_limit: Time limit of an episode, s.
            nodes: Number of nodes of the membrane along x and y; None: 21 x 16.
            timestep: Maximum time step, s; None: that of the CPU.
            device: Warp device; None: Warp's default.

        Raises:
            InputError: A rig, task or object that these worlds do not support.
        """
        self.scenario, self.worlds = scenario, worlds
        self.device = wp.get_device(device)
        plain = with_seed(scenario, scenario.seed)
        if scenario.object == RANDOM:
            self.mix = random_mix()
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "random.xml"
                write_mix(self.mix, file)
                self.rig = build_sim_rig(replace(plain, object=str(file)))
        else:
            self.rig = build_sim_rig(plain)
            self.mix = single(self.rig.scene)
        world = self.rig.scene
        require_supported(scenario, self.rig)
        self.fingers = len(self.rig.fingers)
        self.model = world.model
        self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        step = world.timestep if timestep is None else timestep
        self.substeps = math.ceil(self.rig.period / step - 1e-6)
        self.model.opt.timestep = self.rig.period / self.substeps
        mesh = world.sensors[0].mesh
        self._nodes = (mesh.nx, mesh.ny) if nodes is None else nodes
        with wp.ScopedDevice(self.device):
            self._build(rewards, progress, time_limit)
        self.seeds: Array = np.zeros(0, int)
        self._graph: Any = None

    def _build(self, rewards: dict[str, float], progress: Any, time_limit: float) -> None:
        world, worlds = self.rig.scene, self.worlds
        self._m = mjw.put_model(self.model)
        if not self.device.is_cuda:
            self._m.opt.iterations = min(self._m.opt.iterations, _CPU_ITERATIONS)
            self._m.opt.warn_overflow &= ~mjw.OverflowType.ITERATIONS
        self._d = mjw.put_data(self.model, world.data, nworld=worlds, nconmax=48, njmax=144)
        gripper = int(world.start.gripper)
        self._scene = scene_of(self.model, self._m, worlds, gripper, world.sensors[0].friction)
        self._task = zeros_of(TaskState, worlds)
        gravity = np.tile(self.model.opt.gravity.astype(np.float32), (worlds, 1))
        self._m.opt.gravity = wp.array(gravity, dtype=wp.vec3)
        self._poses = Poses()
        for name in Poses.vars:
            setattr(self._poses, name, getattr(self._d, name))
        sensors = world.sensors
        self.touch = bind_bodies(
            self.model,
            self._m,
            self._d,
            [sensor.body_id for sensor in sensors],
            sensors[0].design,
            self._nodes,
            inertia=self._scene.diagonal,
        )
        self._drive = drive_of(self.rig, self._m, worlds)
        self._goals = zeros_of(Goals, worlds)
        self._commands = zeros_of(Commands, worlds, measured=4)
        self.scores = zeros_of(Scores, worlds)
        is_randomized = self.scenario.randomization != NONE
        self._errors = error_model(load_errors(self.rig.fingers[0].design, is_randomized))
        self._estimates = zeros_of(Estimates, worlds * self.fingers, wrench=6, slow=6)
        task = load_task(self.scenario.task)
        self._limits = limits_of(self.rig, task.goal.task_goal())
        maximum = policy.policy_bounds(self.fingers)
        self._maximum = wp.array(maximum.astype(np.float32), dtype=float)
        self.observation = wp.zeros((worlds, len(maximum)), dtype=float)
        self._build_rewards(rewards, progress, time_limit)
        self._is_plain = not task.disturbances and task.success == SuccessCriteria()
        self._criteria = criteria_of(task.success)
        self._body = self.model.body(f"{PREFIX}object").id

    def _build_rewards(self, rewards: dict[str, float], progress: Any, time_limit: float) -> None:
        paid = [rewards.get(name, 0.0) for name in OUTCOMES]
        self._rewards = wp.array(np.array(paid, np.float32), dtype=float)
        table = np.array(progress, np.float32).reshape(-1, 2)
        self._progress = wp.array(table, dtype=float)
        self._time_limit = time_limit

    def reset(self, seed: int, mask: Any = None) -> None:
        """Start the episodes of `seed`, seed + 1, … in all worlds.

        Args:
            seed: Seed of the first world.
            mask: (worlds,) bool array of Warp: start the next episode of these worlds only. `seed`
                then has no effect.
        """
        with wp.ScopedDevice(self.device):
            if mask is None:
                count = self.worlds * EPISODES
                self.seeds = np.arange(seed, seed + count)
                seeds = self.seeds.tolist()
                sampled = sample_starts(self.scenario, self.rig, self.mix, seeds, self.worlds)
                self._starts, self._events = sampled.starts, sampled.events
                self._kinds = sampled.kinds
                self._graph = None  # it holds the arrays of the previous seeds
                self._seed_generators(seed)
                mask = wp.full(self.worlds, True, dtype=bool)
            self._restart(mask)
            self._observe(0.0)

    def step(self, actions: Any) -> None:
        """Run one control step with `actions` (worlds, 3) in [-1, 1], on the device."""
        with wp.ScopedDevice(self.device):
            wp.launch(
                command_all,
                dim=self.worlds,
                inputs=[
                    *(self._limits, self.fingers, actions, self._estimates, self._commands),
                    *(self._goals, self._d.time),
                ],
            )
            self._run_physics()
            self._observe(float(self.rig.period))
            wp.launch(
                finish_step,
                dim=self.worlds,
                inputs=[
                    *(self.scores, self._limits, self._rewards, self._progress),
                    *(self._time_limit, self.fingers, self._estimates, self._commands),
                    *(self._criteria, self._task, self._starts.row, self._starts.pulls),
                    *(self._body, self._d.time, self._d.qpos, self._d.xquat, self._d.xipos),
                ],
            )

    def restart(self, mask: Any) -> None:
        """Start the next episode in the worlds of `mask`, and write their observations."""
        with wp.ScopedDevice(self.device):
            self._restart(mask)
            self._write_observation()

    @property
    def episode_seeds(self) -> Array:
        """Seed (worlds,) of each world's episode. Waits for the device."""
        return self.seeds[self._starts.row.numpy()]

    @property
    def object_seeds(self) -> Array:
        """Seed (worlds,) of each world's random object, or -1. Waits for the device."""
        seeds = np.array([item.seed for item in self.mix])
        return seeds[self._kinds[self._starts.row.numpy()]]

    def phases(self) -> Array:
        """Return the number (worlds,) of each world's phase. Waits for the device."""
        return self._commands.phase.numpy()

    def commands(self) -> tuple[Array, Array]:
        """Return the commanded openings and lift heights (worlds,), m. Waits for the device."""
        return self._commands.opening.numpy(), self._commands.lift.numpy()

    # -- inside ---------------------------------------------------------------------------------

    def _run_physics(self) -> None:
        if self._graph is None:
            self._substeps()  # compiles; a capture cannot
            with wp.ScopedCapture() as capture:
                self._substeps()
            self._graph = capture.graph
        else:
            wp.capture_launch(self._graph)

    def _substeps(self) -> None:
        m, d = self._m, self._d
        start = int(self.rig.scene.start.gripper)
        for _ in range(self.substeps):
            wp.launch(
                drive_grippers,
                dim=self.worlds,
                inputs=[
                    *(self._drive, self._goals, float(self.model.opt.timestep), d.time),
                    *(d.qpos, d.ctrl),
                ],
            )
            if not self._is_plain:
                self._disturb()
            mjw.step(m, d)
            wp.launch(
                score_step,
                dim=self.worlds,
                inputs=[
                    *(self.scores, self._drive, self.fingers, self._body, start),
                    *(self._criteria.max_drop, self.touch.membrane_wrench),
                    *(self.touch.membrane_status, d.qpos, d.xpos, d.xipos),
                ],
            )
            if not self._is_plain:
                self._score_task()

    def _score_task(self) -> None:
        m, d = self._m, self._d
        starts = self._starts
        wp.launch(
            score_task,
            dim=self.worlds,
            inputs=[
                *(self._task, starts.free_bodies, starts.dof, self.fingers),
                *(float(self.model.opt.timestep), self.scores.counted, m.opt.gravity, d.time),
                *(m.body_mass, d.qfrc_constraint, self.touch.membrane_wrench),
            ],
        )

    def _disturb(self) -> None:
        m, d = self._m, self._d
        up = UP * float(self._limits.lift_height)
        wp.launch(
            disturb_worlds,
            dim=self.worlds,
            inputs=[
                *(self.fingers, up, wp.vec3(*self.model.opt.gravity), self._events, self._starts),
                *(self._scene, self._drive, self.touch.membrane_friction, d.time, d.qpos),
                *(self._task, self._poses, self.touch.membrane_wrench, d.cvel),
                *(m.opt.gravity, d.xfrc_applied),
            ],
        )

    def _restart(self, mask: Any) -> None:
        d = self._d
        wp.launch(
            restart_worlds,
            dim=self.worlds,
            inputs=[
                *(mask, self.fingers, self._starts, self._scene, self._drive, self._goals),
                *(self._commands, self.scores, self._errors, self._estimates),
                *(self.touch.membrane_friction, self.touch.membranes.modulus),
                *(self.touch.membrane_volume, d.time, d.qpos, d.qvel),
                *(d.qacc_warmstart, d.ctrl, d.actuator_force, self._poses, self._task),
            ],
        )
        self.touch.reset(mask)

    def _observe(self, elapsed: float) -> None:
        d = self._d
        wp.launch(
            estimate_all,
            dim=self.worlds * self.fingers,
            inputs=[self._errors, self._estimates, elapsed, self.touch.membrane_wrench],
        )
        wp.launch(
            measure_all,
            dim=self.worlds,
            inputs=[*(self._drive, self._goals, self._commands, d.qpos, d.qvel, d.actuator_force)],
        )
        self._write_observation()

    def _write_observation(self) -> None:
        wp.launch(
            observe_all,
            dim=self.worlds,
            inputs=[
                *(self.fingers, self._maximum, self._estimates, self._commands, self.observation)
            ],
        )

    def _seed_generators(self, seed: int) -> None:
        """Create a separate random generator for each world and sensor. No stream is used twice."""
        streams = np.random.SeedSequence(seed).generate_state(self.worlds * (1 + self.fingers))
        self._commands.random = wp.array(streams[: self.worlds], dtype=wp.uint32)
        self._estimates.random = wp.array(streams[self.worlds :], dtype=wp.uint32)
