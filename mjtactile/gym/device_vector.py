"""Vector environment on one device: thousands of grasps in MuJoCo Warp.

Observations, actions, rewards and seeds are those of `GraspEnv` with quasi-static membranes and
sampled sensing errors (`effects="-mesh,-pipeline"`).
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

try:
    import warp as wp
except ModuleNotFoundError as missing:
    if missing.name != "warp":
        raise
    raise ModuleNotFoundError(
        "MuJoCo Warp is not installed: pip install 'mjtactile[warp]'", name="warp"
    ) from None

from mjtactile.core.errors import InputError
from mjtactile.core.not_copyable import NotCopyable
from mjtactile.core.policy import policy_bounds
from mjtactile.core.scenario import Scenario
from mjtactile.core.signature_checks import above, not_below, validated, within
from mjtactile.core.types import Array
from mjtactile.gym.env import PROGRESS
from mjtactile.recording.policy_data import REWARDS
from mjtactile.rig.domain_randomization import NONE
from mjtactile.warp.device.grasp_phase import NAMES
from mjtactile.warp.device.grasp_score import OUTCOMES
from mjtactile.warp.device.restart import clear_results, find_over
from mjtactile.warp.grasps import Grasps
from mjtactile.warp.starts import ignored_parameters

_SOURCE = "Grasp-v0 with a device"
_RESET = f"{_SOURCE}: reset"


_TIMESTEP = within(1e-3, 7e-3)
_MIN_NODES = 7  # of a side: the contact of an egg covers two of them
_MAX_NODES = 61


@validated(num_envs=not_below(1), time_limit=above(0, math.inf), timestep=_TIMESTEP)
class DeviceVectorEnv(NotCopyable, gymnasium.vector.VectorEnv[Any, Any, Any]):
    """`num_envs` grasps on one device. World k of `reset(seed=s)` has the seed s + k.

    Arrays are tensors of PyTorch that share memory with the device where PyTorch is installed, else
    NumPy arrays. Tensors are overwritten by the next step.

    Args:
        num_envs: Number of grasps.
        device: Warp device, such as "cuda" or "cpu".
        autoreset_mode: Mode of Gymnasium. Disabled: `reset` restarts the worlds of a mask.
        object: Argument of `GraspEnv`; so are `sensor`, `rig`, `randomization`, `time_limit`,
            `task`, `reward`. "random": 256 rigid random objects (`truth()["object_seed"]`).
        nodes: Number of nodes of the membrane along x and y; None: 21 x 16. Fewer are faster.
        timestep: Maximum time step, s; None: 2.08 ms.

    Raises:
        InputError: A name does not exist, or the worlds do not support it.
    """

    REMEDY = "create another environment and reset it with the same seed"

    def __init__(
        self,
        num_envs: int,
        device: str,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        object: str = "egg",
        sensor: str = "dense",
        rig: str = "sim",
        randomization: str = NONE,
        time_limit: float = 20.0,
        task: str = "lift",
        reward: str = "outcome",
        nodes: tuple[int, int] | None = None,
        timestep: float | None = None,
    ):
        if reward not in ("outcome", "progress"):
            choices = ["outcome", "progress"]
            raise InputError(f"{reward!r}", source=_SOURCE, field="reward", choices=choices)
        self._mode = AutoresetMode(autoreset_mode)
        names: Any = {"object": object, "sensor": sensor, "rig": rig, "task": task}
        self.scenario = Scenario(**names, randomization=randomization)
        self.ignored = ignored_parameters(randomization)
        """Parameters of the randomization that have no effect on a device."""
        self._grasps = Grasps(
            self.scenario,
            num_envs,
            rewards=REWARDS,
            progress=list(PROGRESS.values()) if reward == "progress" else (),
            time_limit=time_limit,
            nodes=_checked_nodes(nodes),
            timestep=timestep,
            device=device,
        )
        self.timestep = float(self._grasps.model.opt.timestep)
        """Time step, s: a whole number of them is a camera period."""
        self.num_envs = num_envs
        self.metadata = {
            "render_modes": [],
            "render_fps": round(1 / self._grasps.rig.period),
            "autoreset_mode": self._mode,
        }
        maximum = policy_bounds(self._grasps.fingers).astype(np.float32)
        self.single_observation_space = gymnasium.spaces.Box(-maximum, maximum, dtype=np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._torch = _torch()
        with wp.ScopedDevice(self._grasps.device):
            self._actions = wp.zeros((num_envs, 3), dtype=float)
            self._over = wp.zeros(num_envs, dtype=bool)
        self._started = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start the episodes of `seed`, seed + 1, … (None: the generator's next).

        `options={"reset_mask": mask}` starts the next episodes of the worlds of a mask only.
        """
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            text = f"{seed!r} is not a whole number of at least 0"
            raise InputError(text, source=_RESET, field="seed")
        if set(options or {}) - {"reset_mask"} or (options and seed is not None):
            text = f"{options!r} has no effect; object and task are arguments of the environment"
            raise InputError(text, source=_RESET, field="options", choices=["None", "reset_mask"])
        if options and self._started:
            self._write("reset_mask", options["reset_mask"], self._over)
            self._grasps.restart(self._over)
            return self._observation(self._grasps.observation), {}
        super().reset(seed=None if seed is None else int(seed))
        first = int(self.np_random.integers(2**31)) if seed is None else int(seed)
        self._grasps.reset(first)
        self._over.zero_()
        self._started = True
        return self._observation(self._grasps.observation), {"seed": self._grasps.episode_seeds}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all worlds by one camera period. Worlds whose episode has ended start the next one.

        `info["outcome"]` (num_envs,) holds indices into `OUTCOMES`: 0 while an episode continues.
        """
        if not self._started:
            raise gymnasium.error.ResetNeeded("no episode has started: call reset()")
        self._write("actions", actions, self._actions)
        grasps = self._grasps
        grasps.step(self._actions)
        scores = grasps.scores
        ends = (scores.terminated, scores.truncated)
        info: dict[str, Any] = {}
        if self._mode == AutoresetMode.NEXT_STEP:
            self._launch(clear_results, self._over, scores.reward, *ends)
            grasps.restart(self._over)
            self._launch(find_over, *ends, self._over)
        elif self._mode == AutoresetMode.SAME_STEP:
            info["final_obs"] = self._copied(grasps.observation)
            self._launch(find_over, *ends, self._over)
            info["outcome"] = self._copied(scores.outcome)
            grasps.restart(self._over)
        info.setdefault("outcome", self._observation(scores.outcome))
        shown = (grasps.observation, scores.reward, scores.terminated, scores.truncated)
        observation, reward, terminated, truncated = (self._observation(array) for array in shown)
        return observation, reward, terminated, truncated, info

    def truth(self) -> dict[str, Array]:
        """Return ground truth of all worlds, which no observation may contain.

        Waits for the device. Forces in N; names as in `GraspEnv`'s `info`.
        """
        scores = self._grasps.scores
        steps = np.maximum(scores.hold_steps.numpy(), 1)
        return {
            "outcome": np.array(OUTCOMES)[scores.outcome.numpy()],
            "phase": np.array(NAMES)[self._grasps.phases()],
            "seed": self._grasps.episode_seeds,
            "object_seed": self._grasps.object_seeds,
            "peak_force_true_N": scores.peak_force.numpy(),
            "hold_force_true_N": scores.hold_force.numpy() / steps,
            "slip_mm_true": 1e3 * scores.slip.numpy(),
            "break_force_N": scores.break_force.numpy(),
            "force_normal_true_N": -self._grasps.touch.wrench.numpy()[..., 2],
            "rejected_solutions": scores.rejected.numpy(),
        }

    def commands(self) -> tuple[Array, Array]:
        """Return the commanded openings and lift heights (num_envs,), m. Waits for the device."""
        return self._grasps.commands()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the simulation."""
        self._grasps.rig.close()

    def _launch(self, kernel: Any, *arrays: Any) -> None:
        wp.launch(kernel, self.num_envs, list(arrays), device=self._grasps.device)

    def _write(self, field: str, values: Any, like: wp.array) -> None:
        """Copy an argument to the array `like` on the device."""
        found = tuple(getattr(values, "shape", np.shape(values)))
        if found != like.shape:
            text = f"shape {found} does not match {like.shape}"
            raise InputError(text, source=_SOURCE, field=field)
        is_bool = like is self._over
        if self._torch is not None and isinstance(values, self._torch.Tensor):
            dtype = self._torch.bool if is_bool else self._torch.float32
            values = wp.from_torch(values.detach().to(dtype).contiguous(), dtype=like.dtype)
        elif not isinstance(values, wp.array):
            values = np.ascontiguousarray(values, np.bool_ if is_bool else np.float32)
        like.assign(values)

    def _observation(self, array: Any) -> Any:
        return array.numpy() if self._torch is None else wp.to_torch(array)

    def _copied(self, array: Any) -> Any:
        return self._observation(wp.clone(array))


def _checked_nodes(nodes: tuple[int, int] | None) -> tuple[int, int] | None:
    """Return `nodes`. Raises InputError for a grid that is too coarse or too fine."""
    if nodes is not None and not all(_MIN_NODES <= count <= _MAX_NODES for count in nodes):
        text = f"{nodes} is not within {_MIN_NODES} to {_MAX_NODES} nodes on each side"
        raise InputError(text, source=_SOURCE, field="nodes")
    return nodes


def _torch() -> Any:
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        return None
    return torch
