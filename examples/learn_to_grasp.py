"""Learn to grasp from nothing, with stable-baselines3: pip install 'mjtactile[learn]'

    python examples/learn_to_grasp.py policy.npz 600     # seconds
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

Touch is drawn meanwhile (`-sheet,-chain`); the second line judges with everything simulated.
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
# An action of 0 closes slowly, with 1 N, and stays down: noise about it neither crushes nor rises
# before anything is held
MIDDLE, SPAN = np.array([-0.3, -0.75, -0.4]), np.array([0.7, 0.15, 1.0])


class Scaled(gymnasium.Wrapper):
    """Numbers of about one, actions about MIDDLE, and each for several steps of 33 ms."""

    def __init__(self, env, repeat=4):
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
            total += float(reward)
            if terminated or truncated:
                break
        return (shown / SCALE).astype(np.float32), total, terminated, truncated, info


def make(number):
    thing = f"random:{FIRST_THING + number}"
    how = {"effects": "-sheet,-chain", "vary": "default", "reward": "progress", "time_limit": 10.0}
    return Scaled(gymnasium.make("mjtactile.gym:mjtactile/Grasp-v0", object=thing, **how))


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


def main(path="policy.npz", seconds="600"):
    envs = DummyVecEnv([lambda k=k: make(k) for k in range(ENVIRONMENTS)])
    net = {"net_arch": [32, 32], "log_std_init": -1.0}
    model = PPO("MlpPolicy", envs, 1e-3, 64, 128, gamma=0.98, policy_kwargs=net, verbose=1)
    end = time.monotonic() + float(seconds)
    while time.monotonic() < end:
        model.learn(64 * ENVIRONMENTS, reset_num_timesteps=False)
    save(model, path)


if __name__ == "__main__":
    main(*sys.argv[1:])
