"""Learn to grasp from nothing, with stable-baselines3: pip install 'mjtactile[learn]'

    python examples/learn_to_grasp.py policy.npz 600     # seconds
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

Touch is drawn meanwhile (`-sheet,-chain`), and each environment has a random thing of its own; the
second line judges what was learned with everything simulated. What it sees and does is that of
`controllers/policy.py`, which loads the file.
"""

import sys
import time

import gymnasium
import numpy as np
from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.vec_env import DummyVecEnv  # pyright: ignore[reportMissingImports]

import mjtactile

ENVIRONMENTS = 8
FIRST_THING = 100  # random:100 and on: those of `evaluate` begin at 0
UNITS = {"N": 1.0, "Nm": 5e-3, "m": 0.04, "s": 1.0}
SCALE = np.array([UNITS.get(name.rpartition("_")[2], 1.0) for name in mjtactile.policy_names()])
SCALE[mjtactile.policy_names().index("speed_m_s")] = 0.05


class Scaled(gymnasium.Wrapper):
    """Numbers of about one, and an action that stands for several steps of 33 ms."""

    def __init__(self, env, repeat=4):
        super().__init__(env)
        self.repeat = repeat
        most = (env.observation_space.high / SCALE).astype(np.float32)
        self.observation_space = gymnasium.spaces.Box(-most, most, dtype=np.float32)

    def reset(self, **how):
        shown, info = self.env.reset(**how)
        return (shown / SCALE).astype(np.float32), info

    def step(self, action):
        total = 0.0
        for _ in range(self.repeat):
            shown, reward, terminated, truncated, info = self.env.step(action)
            total += float(reward)
            if terminated or truncated:
                break
        return (shown / SCALE).astype(np.float32), total, terminated, truncated, info


def make(number):
    env = gymnasium.make(
        "mjtactile.gym:mjtactile/Grasp-v0",
        object=f"random:{FIRST_THING + number}",
        effects="-sheet,-chain",
        vary="default",
        reward="progress",
        time_limit=10.0,
    )
    return Scaled(env)


def save(model, path):
    """As `controllers/policy.py` reads it: tanh between layers, with the scale in the first."""
    layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    arrays = {}
    for k, layer in enumerate(one for one in layers if hasattr(one, "weight")):
        arrays[f"w{k}"] = layer.weight.detach().numpy() / (SCALE if k == 0 else 1.0)
        arrays[f"b{k}"] = layer.bias.detach().numpy()
    np.savez(path, **arrays)


def main(path="policy.npz", seconds="600"):
    envs = DummyVecEnv([lambda k=k: make(k) for k in range(ENVIRONMENTS)])
    net = {"net_arch": [32, 32], "log_std_init": -0.5}
    model = PPO("MlpPolicy", envs, 1e-3, 64, 128, gamma=0.98, policy_kwargs=net, verbose=1)
    end = time.monotonic() + float(seconds)
    while time.monotonic() < end:
        model.learn(64 * ENVIRONMENTS, reset_num_timesteps=False)
    save(model, path)


if __name__ == "__main__":
    main(*sys.argv[1:])
