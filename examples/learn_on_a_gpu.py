"""Learn to grasp from scratch in thousands of worlds: pip install 'mjtactile[learn,warp]'

    python examples/learn_on_a_gpu.py policy.npz 300     # seconds
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

The learner is PPO of rsl-rl-lib, which mjlab and Isaac Lab use, too: it keeps observations, actions
and rewards on the device, in tensors that share memory with the worlds. The second command
evaluates the policy with everything simulated. Without a GPU it runs on the CPU; use few worlds
there.
"""

import sys
import time

import gymnasium
import torch  # pyright: ignore[reportMissingImports]
from rsl_rl.env import VecEnv  # pyright: ignore[reportMissingImports]
from rsl_rl.runners import OnPolicyRunner  # pyright: ignore[reportMissingImports]
from tensordict import TensorDict  # pyright: ignore[reportMissingImports]

from mjtactile.gym.wrappers import MIDDLE, SCALE, SPAN, save_policy

STEPS = 8  # control steps for each decision: 0.27 s
FEAR = 0.3  # maximum penalty of a failure; at 1, some learners stop lifting
HELD = 1  # number of the outcome "held"
TASK = {"object": "random", "randomization": "default", "reward": "progress", "time_limit": 12.0}
LEARNER = {
    "num_steps_per_env": 8,
    "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
    "actor": {
        "class_name": "MLPModel",
        "hidden_dims": [32, 32],
        "activation": "tanh",
        "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.37},
    },
    "critic": {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "tanh"},
    "algorithm": {
        "class_name": "PPO",
        "num_learning_epochs": 5,
        "num_mini_batches": 8,
        "gamma": 0.97,
        "entropy_coef": 0.01,
        "learning_rate": 1e-3,
    },
}


class Decisions(VecEnv):
    """Worlds with scaled observations and actions, as behind `ActionRepeatScaling`.

    An action is repeated for `STEPS` control steps. Worlds whose grasp ends then start the next
    one.
    """

    def __init__(self, worlds, device, task):
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
            torch.tensor(one, dtype=torch.float32, device=device) for one in (SCALE, MIDDLE, SPAN)
        )
        self.shown, _ = self.worlds.reset(seed=1_000_000)  # other seeds than `evaluate`
        self.ended = self.held = 0  # grasps
        self.paid = torch.zeros(worlds, device=device)  # in the present grasp
        self.returns = []  # means over the grasps that end with a decision

    def get_observations(self):
        return TensorDict({"policy": self.shown / self.scale}, batch_size=self.num_envs)

    def step(self, actions):
        own = self.middle + self.span * actions
        reward = torch.zeros(self.num_envs, device=self.device)
        over, late, held = (torch.zeros_like(reward, dtype=torch.bool) for _ in range(3))
        for _ in range(STEPS):
            _, paid, terminated, truncated, info = self.worlds.step(own)
            reward += torch.where(over, 0.0, paid.clamp(min=-FEAR))
            late |= truncated & ~over
            held |= (info["outcome"] == HELD) & ~over
            over |= terminated | truncated
        self.shown, _ = self.worlds.reset(options={"reset_mask": over})
        self.episode_length_buf = torch.where(over, 0, self.episode_length_buf + 1)
        self.paid += reward
        if over.any():
            self.ended += int(over.sum())
            self.held += int(held.sum())
            self.returns.append(float(self.paid[over].mean()))
        self.paid = torch.where(over, 0.0, self.paid)
        return self.get_observations(), reward, over, {"time_outs": late}

    def report(self):
        """Return the mean return and the outcomes since the last report."""
        mean = sum(self.returns) / max(len(self.returns), 1)
        text = f"{self.ended} grasps, {self.held} held, return {mean:.2f}"
        self.ended, self.held, self.returns = 0, 0, []
        return text


def save(actor, path):
    layers = [layer for layer in actor.mlp if isinstance(layer, torch.nn.Linear)]
    numbers = [(x.weight.detach().cpu().numpy(), x.bias.detach().cpu().numpy()) for x in layers]
    save_policy(path, numbers, activation="tanh")


def learn(seconds, worlds, device, task=TASK, seed=0):
    """Return the learned actor, and the number of decisions."""
    torch.manual_seed(seed)
    env = Decisions(worlds, device, dict(task))
    runner = OnPolicyRunner(env, dict(LEARNER), device=device)
    start = reported = time.monotonic()
    decisions = 0
    while time.monotonic() < start + seconds:
        runner.learn(1)
        decisions += worlds * LEARNER["num_steps_per_env"]
        if time.monotonic() > reported + 10:
            reported = time.monotonic()
            print(f"{reported - start:.0f} s, {decisions} decisions; {env.report()}", flush=True)
    env.worlds.close()
    return runner.alg.get_policy(), decisions


def main(path="policy.npz", seconds="300", worlds="", device=""):
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    count = int(worlds or (4096 if device.startswith("cuda") else 16))
    actor, decisions = learn(float(seconds), count, device)
    save(actor, path)
    print(f"{decisions} decisions; policy in {path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
