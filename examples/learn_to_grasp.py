"""Learn to grasp from nothing, with stable-baselines3: pip install 'mjtactile[learn]'

    python examples/learn_to_grasp.py policy.npz 600     # seconds
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

Touch is drawn meanwhile (`-sheet,-chain`); the second line judges with everything simulated.
"""

import os
import sys
import time
from collections import Counter, deque

import gymnasium
import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.callbacks import BaseCallback  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.vec_env import SubprocVecEnv  # pyright: ignore[reportMissingImports]

import mjtactile

ENVIRONMENTS = 8  # a process each: with fewer, a core waits while another begins an episode
DECISIONS = 32  # of each environment between two updates: about a grasp
FEAR = 0.3  # the most that an end costs: at 1, some learners never lift again
UNITS = {"N": 1.0, "Nm": 5e-3, "m": 0.04, "s": 1.0}
SCALE = np.array([UNITS.get(name.rpartition("_")[2], 1.0) for name in mjtactile.policy_names()])
SCALE[mjtactile.policy_names().index("speed_m_s")] = 0.05
SCALE[mjtactile.policy_names().index("goal_ahead_m")] = 0.004
# An action of 0 closes slowly, with 1 N, and stays down: noise about it neither crushes nor rises
# before anything is held
MIDDLE, SPAN = np.array([-0.2, -0.75, -0.4]), np.array([0.8, 0.15, 1.0])


class Scaled(gymnasium.Wrapper):
    """Numbers of about one, actions about MIDDLE, and each for several steps of 33 ms: thirty
    decisions a grasp."""

    def __init__(self, env, repeat=8):
        super().__init__(env)
        self.repeat = repeat
        most = (env.observation_space.high / SCALE).astype(np.float32)
        self.observation_space = gymnasium.spaces.Box(-most, most, dtype=np.float32)
        low, high = ((end - MIDDLE) / SPAN for end in (-1.0, 1.0))
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float64)

    def reset(self, **how):
        shown, info = self.env.reset(**how)
        return (shown / SCALE).astype(np.float32), info

    def step(self, action):
        total = 0.0
        for _ in range(self.repeat):
            shown, reward, terminated, truncated, info = self.env.step(MIDDLE + SPAN * action)
            total += max(float(reward), -FEAR)
            if terminated or truncated:
                break
        return (shown / SCALE).astype(np.float32), total, terminated, truncated, info


def make():
    """Another random thing each time; the generator's seeds are far from those of `evaluate`."""
    how = {"effects": "-sheet,-chain", "vary": "default", "reward": "progress", "time_limit": 12.0}
    return Scaled(gymnasium.make("mjtactile.gym:mjtactile/Grasp-v0", object="random", **how))


class Told(BaseCallback):
    """How the last grasps ended, twice a minute; and the end after `seconds`."""

    def __init__(self, seconds):
        super().__init__()
        self.seconds = seconds

    def _on_training_start(self):
        self.ended = deque(maxlen=100)
        self.begin = self.told = time.monotonic()

    def _on_step(self):
        self.ended += [info["outcome"] for info in self.locals["infos"] if "outcome" in info]
        now = time.monotonic()
        if now > self.told + 30:
            self.told = now
            print(f"{now - self.begin:.0f} s, {self.num_timesteps} decisions, the last hundred:")
            print("   ", dict(Counter(self.ended)), flush=True)
        return now < self.begin + self.seconds


def save(model, path):
    """As `controllers/policy.py` reads it: tanh between layers, with the scales at both ends."""
    layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    arrays = {}
    for k, layer in enumerate(one for one in layers if hasattr(one, "weight")):
        arrays[f"w{k}"] = layer.weight.detach().numpy()
        arrays[f"b{k}"] = layer.bias.detach().numpy()
    arrays["w0"] = arrays["w0"] / SCALE
    arrays["w2"] = arrays["w2"] * SPAN[:, None]
    arrays["b2"] = MIDDLE + SPAN * arrays["b2"]
    np.savez(path, **arrays)


def main(path="policy.npz", seconds="600", seed="0"):
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the processes: threads fight for the cores
    torch.set_num_threads(1)
    envs = SubprocVecEnv([make] * ENVIRONMENTS)
    net = {"net_arch": [32, 32], "log_std_init": -1.0}
    how = {"gamma": 0.97, "ent_coef": 0.01, "policy_kwargs": net, "device": "cpu"}
    model = PPO("MlpPolicy", envs, 1e-3, DECISIONS, 64, seed=int(seed), **how)
    model.learn(10_000_000, callback=Told(float(seconds)))
    envs.close()
    save(model, path)


if __name__ == "__main__":
    main(*sys.argv[1:])
