"""Learn to grasp from scratch in thousands of worlds: pip install 'mjtactile[learn,warp]'

    python examples/learn_on_a_gpu.py policy.npz 300                       # seconds
    python examples/learn_on_a_gpu.py policy.npz 900 lift,pour,shake,bump  # further, tasks by turns
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

A policy file that exists is learned further. The learner is PPO of rsl-rl-lib, which mjlab and
Isaac Lab use, too: it keeps observations, actions and rewards on the device, in tensors that share
memory with the worlds. The last command evaluates the policy with everything simulated. Without a
GPU it runs on the CPU with coarse membranes and long steps, and needs an hour of one core.
"""

import sys
import time
from pathlib import Path

import torch  # pyright: ignore[reportMissingImports]
from rsl_rl.runners import OnPolicyRunner  # pyright: ignore[reportMissingImports]

from mjtactile.gym.rsl_rl_worlds import RslRlWorlds
from mjtactile.gym.wrappers import policy_layers, save_policy

COARSE = {"nodes": (9, 7), "timestep": 4.2e-3}  # a tenth of the time; + 8 % force
TASK = {"object": "random", "randomization": "default", "reward": "progress"}
TIME_LIMIT = {"lift": 12.0}  # s
LONG_TASK = 25.0  # time limit of the other tasks, s
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
SMALLER = {"learning_rate": 3e-4, "entropy_coef": 0.0, "schedule": "fixed"}  # learned further


def linear_layers(actor):
    return [layer for layer in actor.mlp if isinstance(layer, torch.nn.Linear)]


def save(actor, path):
    layers = linear_layers(actor)
    numbers = [(x.weight.detach().cpu().numpy(), x.bias.detach().cpu().numpy()) for x in layers]
    save_policy(path, numbers, activation="tanh")


def load(actor, path):
    with torch.no_grad():
        for layer, (weights, biases) in zip(linear_layers(actor), policy_layers(path), strict=True):
            layer.weight.copy_(torch.as_tensor(weights))
            layer.bias.copy_(torch.as_tensor(biases))


def learner(continued):
    """Return the settings: less noise and smaller steps for a policy that is learned further."""
    if not continued:
        return dict(LEARNER)
    noise = {"distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.2}}
    algorithm = LEARNER["algorithm"] | SMALLER
    return LEARNER | {"actor": LEARNER["actor"] | noise, "algorithm": algorithm}


def learn(seconds, worlds, device, tasks=("lift",), seed=0, path=None, **changed):
    """Return the learned actor, and the number of decisions. Each task has its own worlds, and the
    tasks take turns. A policy at `path` is learned further, and saved there with each report."""
    torch.manual_seed(seed)
    how = TASK | (COARSE if device == "cpu" else {}) | changed
    limits = {task: TIME_LIMIT.get(task, LONG_TASK) for task in tasks}
    envs = {
        task: RslRlWorlds(worlds, device, how | {"task": task, "time_limit": limit})
        for task, limit in limits.items()
    }
    continued = path is not None and Path(path).exists()
    runner = OnPolicyRunner(envs[tasks[0]], learner(continued), device=device)
    actor = runner.alg.get_policy()
    if continued:
        load(actor, path)
    start = reported = time.monotonic()
    decisions = 0
    while time.monotonic() < start + seconds:
        actor.requires_grad_(not continued or decisions > 0)  # the critic learns first
        for env in envs.values():
            runner.env = env
            runner.learn(1)
            decisions += worlds * LEARNER["num_steps_per_env"]
        if time.monotonic() > reported + 10:
            reported = time.monotonic()
            text = "; ".join(f"{task}: {env.report()}" for task, env in envs.items())
            print(f"{reported - start:.0f} s, {decisions} decisions; {text}", flush=True)
            if path is not None:
                save(actor, path)
    for env in envs.values():
        env.worlds.close()
    return actor, decisions


def main(path="policy.npz", seconds="300", tasks="lift", worlds="", device=""):
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    count = int(worlds or (4096 if device.startswith("cuda") else 64))
    actor, decisions = learn(float(seconds), count, device, tasks.split(","), path=path)
    save(actor, path)
    print(f"{decisions} decisions; policy in {path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
