"""Worlds on one device for the learners of rsl-rl, which mjlab and Isaac Lab use, too.

It needs the extras `learn` and `warp`; no other module imports it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import torch  # pyright: ignore[reportMissingImports]
from rsl_rl.env import VecEnv  # pyright: ignore[reportMissingImports]
from tensordict import TensorDict  # pyright: ignore[reportMissingImports]

from mjtactile.gym.wrappers import MIDDLE, SCALE, SPAN, policy_layers, save_policy

STEPS = 8  # control steps for each decision: 0.27 s
MAX_PENALTY = 0.3  # of a failure; at 1, some learners stop lifting
_HELD = 1  # number of the outcome "held"


class RslRlWorlds(VecEnv):
    """Worlds of `mjtactile/Grasp-v0` on one device, as rsl-rl expects them.

    Observations and actions are scaled as by `ActionRepeatScaling`. An action is repeated for
    `STEPS` control steps. Worlds whose grasp ends then start the next one.

    Args:
        worlds: Number of worlds.
        device: Device of PyTorch and Warp, such as "cuda" or "cpu".
        task: Arguments of `gymnasium.make_vec`; `time_limit`, s, is required.
    """

    def __init__(self, worlds: int, device: str, task: dict[str, Any]):
        self.worlds = gymnasium.make_vec(
            "mjtactile.gym:mjtactile/Grasp-v0",
            num_envs=worlds,
            vectorization_mode="vector_entry_point",
            autoreset_mode="Disabled",
            device=device,
            **task,
        )
        self.num_envs, self.num_actions, self.device, self.cfg = worlds, 3, device, task
        period = STEPS / self.worlds.metadata["render_fps"]
        self.max_episode_length = round(task["time_limit"] / period)
        self.episode_length_buf = torch.zeros(worlds, dtype=torch.long, device=device)
        self.scale, self.middle, self.span = (
            torch.tensor(values, dtype=torch.float32, device=device)
            for values in (SCALE, MIDDLE, SPAN)
        )
        self.observation, _ = self.worlds.reset(seed=1_000_000)  # other seeds than `evaluate`
        self.ended = self.held = 0  # grasps
        self.episode_return = torch.zeros(worlds, device=device)  # in the present grasp
        self.returns = []  # means over the grasps that end with a decision

    def get_observations(self) -> TensorDict:
        """Return the scaled observations of all worlds."""
        return TensorDict({"policy": self.observation / self.scale}, batch_size=self.num_envs)

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict]:
        """Take one decision in each world.

        Args:
            actions: Scaled actions (worlds, 3).

        Returns:
            Scaled observations, rewards, ended grasps, and the grasps that ended by time.
        """
        unscaled = self.middle + self.span * actions
        reward = torch.zeros(self.num_envs, device=self.device)
        over, late, held = (torch.zeros_like(reward, dtype=torch.bool) for _ in range(3))
        for _ in range(STEPS):
            _, gained, terminated, truncated, info = self.worlds.step(unscaled)
            reward += torch.where(over, 0.0, gained.clamp(min=-MAX_PENALTY))
            late |= truncated & ~over
            held |= (info["outcome"] == _HELD) & ~over
            over |= terminated | truncated
        self.observation, _ = self.worlds.reset(options={"reset_mask": over})
        self.episode_length_buf = torch.where(over, 0, self.episode_length_buf + 1)
        self.episode_return += reward
        if over.any():
            self.ended += int(over.sum())
            self.held += int(held.sum())
            self.returns.append(float(self.episode_return[over].mean()))
        self.episode_return = torch.where(over, 0.0, self.episode_return)
        return self.get_observations(), reward, over, {"time_outs": late}

    def report(self) -> str:
        """Return the mean return and the outcomes since the last report."""
        mean = sum(self.returns) / max(len(self.returns), 1)
        text = f"{self.ended} grasps, {self.held} held, return {mean:.2f}"
        self.ended, self.held, self.returns = 0, 0, []
        return text


def save_actor(actor: Any, path: str | Path) -> None:
    """Write a learned actor of rsl-rl with tanh between its layers for `controllers/policy.py`."""
    layers = [
        (layer.weight.detach().cpu().numpy(), layer.bias.detach().cpu().numpy())
        for layer in linear_layers(actor)
    ]
    save_policy(path, layers, activation="tanh")


def load_actor(actor: Any, path: str | Path) -> None:
    """Read the layers of a file of `save_actor` into an actor with as many, to learn further."""
    with torch.no_grad():
        for layer, (weights, biases) in zip(linear_layers(actor), policy_layers(path), strict=True):
            layer.weight.copy_(torch.as_tensor(weights))
            layer.bias.copy_(torch.as_tensor(biases))


def linear_layers(actor: Any) -> list[Any]:
    """Return the linear layers of an actor of rsl-rl, first to last."""
    return [layer for layer in actor.mlp if isinstance(layer, torch.nn.Linear)]
