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
from stable_baselines3.common.callbacks import BaseCallback  # pyright: ignore[reportMissingImports]
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


class Clock(BaseCallback):
    """Ends the training after so many seconds, and says how it goes."""

    def __init__(self, seconds):
        super().__init__()
        self.end = time.monotonic() + seconds
        self.outcomes = []

    def _on_step(self):
        self.outcomes += [info["outcome"] for info in self.locals["infos"] if "outcome" in info]
        return time.monotonic() < self.end

    def _on_rollout_end(self):
        last = self.outcomes[-50:]
        held = f"held {last.count('held')} of the last {len(last)}"
        print(f"{self.num_timesteps} decisions, {len(self.outcomes)} grasps: {held}", flush=True)


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
    weights = [one for one in layers if hasattr(one, "weight")]
    arrays = {}
    for k, layer in enumerate(weights):
        w = layer.weight.detach().numpy()
        arrays[f"w{k}"] = w / SCALE if k == 0 else w
        arrays[f"b{k}"] = layer.bias.detach().numpy()
    np.savez(path, **arrays)


def main(path="policy.npz", seconds="600"):
    envs = DummyVecEnv([lambda k=k: make(k) for k in range(ENVIRONMENTS)])
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=64,
        batch_size=128,
        gamma=0.98,
        ent_coef=0.003,
        learning_rate=1e-3,
        policy_kwargs={"net_arch": [32, 32], "log_std_init": -0.5},
        seed=1,
        device="cpu",
    )
    model.learn(10_000_000, callback=Clock(float(seconds)))
    save(model, path)


if __name__ == "__main__":
    main(*sys.argv[1:])
