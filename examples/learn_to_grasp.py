"""Learn to grasp from scratch, with stable-baselines3: pip install 'mjtactile[learn]'

    python examples/learn_to_grasp.py policy.npz 600     # seconds
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

Training uses synthetic touch (`-mesh,-pipeline`). The second command evaluates with everything
simulated.
"""

import os
import sys
import time
from collections import Counter, deque

import gymnasium
import torch  # pyright: ignore[reportMissingImports]
from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.callbacks import BaseCallback  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.vec_env import SubprocVecEnv  # pyright: ignore[reportMissingImports]

from mjtactile.gym.wrappers import ActionRepeatScaling, save_policy

ENVIRONMENTS = 8  # a process each: with fewer, a core waits while another starts an episode
DECISIONS = 32  # steps of each environment between two updates: about one grasp


def make():
    """Create an environment with a new random object per episode; its seeds differ from
    `evaluate`."""
    how = {
        "effects": "-mesh,-pipeline",
        "randomization": "default",
        "reward": "progress",
        "time_limit": 12.0,
    }
    return ActionRepeatScaling(
        gymnasium.make("mjtactile.gym:mjtactile/Grasp-v0", object="random", **how)
    )


class ProgressCallback(BaseCallback):
    """Callback that prints the last outcomes twice a minute, and ends training after `seconds`."""

    def __init__(self, seconds):
        super().__init__()
        self.seconds = seconds

    def _on_training_start(self):
        self.ended = deque(maxlen=100)
        self.start = self.reported = time.monotonic()

    def _on_step(self):
        self.ended += [info["outcome"] for info in self.locals["infos"] if "outcome" in info]
        now = time.monotonic()
        if now > self.reported + 30:
            self.reported = now
            print(f"{now - self.start:.0f} s, {self.num_timesteps} decisions, the last hundred:")
            print("   ", dict(Counter(self.ended)), flush=True)
        return now < self.start + self.seconds


def save(model, path):
    layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    linear = [layer for layer in layers if hasattr(layer, "weight")]
    numbers = [(x.weight.detach().numpy(), x.bias.detach().numpy()) for x in linear]
    save_policy(path, numbers, activation=model.policy.activation_fn.__name__.lower())


def main(path="policy.npz", seconds="600", seed="0"):
    # one thread per process: more would compete for the cores
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    torch.set_num_threads(1)
    envs = SubprocVecEnv([make] * ENVIRONMENTS)
    net = {"net_arch": [32, 32], "log_std_init": -1.0}
    how = {"gamma": 0.97, "ent_coef": 0.01, "policy_kwargs": net, "device": "cpu"}
    model = PPO("MlpPolicy", envs, 1e-3, DECISIONS, 64, seed=int(seed), **how)
    model.learn(10_000_000, callback=ProgressCallback(float(seconds)))
    envs.close()
    save(model, path)


if __name__ == "__main__":
    main(*sys.argv[1:])
