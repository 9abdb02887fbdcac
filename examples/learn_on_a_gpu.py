"""Learn to grasp from scratch in thousands of worlds: pip install 'mjtactile[learn,warp]'

    python examples/learn_on_a_gpu.py policy.npz 300                        # seconds
    python examples/learn_on_a_gpu.py policy.npz 900 lift,pour,shake,bump   # tasks by turns
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

The learner is PPO of rsl-rl-lib, which mjlab and Isaac Lab use, too: it keeps observations, actions
and rewards on the device, in tensors that share memory with the worlds. The second command
evaluates the policy with everything simulated. Without a GPU it runs on the CPU with coarse
membranes and long steps, and needs an hour of one core.
"""

import sys
import time

import torch  # pyright: ignore[reportMissingImports]
from rsl_rl.runners import OnPolicyRunner  # pyright: ignore[reportMissingImports]

from mjtactile.gym.rsl_rl_worlds import RslRlWorlds
from mjtactile.gym.wrappers import save_policy

COARSE = {"nodes": (9, 7), "timestep": 4.2e-3}  # a tenth of the time; + 8 % force
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


def save(actor, path):
    layers = [layer for layer in actor.mlp if isinstance(layer, torch.nn.Linear)]
    numbers = [(x.weight.detach().cpu().numpy(), x.bias.detach().cpu().numpy()) for x in layers]
    save_policy(path, numbers, activation="tanh")


def learn(seconds, worlds, device, tasks=("lift",), seed=0, **changed):
    """Return the learned actor, and the number of decisions. Each task has its own worlds, and the
    tasks take turns."""
    torch.manual_seed(seed)
    how = TASK | (COARSE if device == "cpu" else {}) | changed
    envs = {task: RslRlWorlds(worlds, device, how | {"task": task}) for task in tasks}
    runner = OnPolicyRunner(envs[tasks[0]], dict(LEARNER), device=device)
    start = reported = time.monotonic()
    decisions = 0
    while time.monotonic() < start + seconds:
        for env in envs.values():
            runner.env = env
            runner.learn(1)
            decisions += worlds * LEARNER["num_steps_per_env"]
        if time.monotonic() > reported + 10:
            reported = time.monotonic()
            text = "; ".join(f"{task}: {env.report()}" for task, env in envs.items())
            print(f"{reported - start:.0f} s, {decisions} decisions; {text}", flush=True)
    for env in envs.values():
        env.worlds.close()
    return runner.alg.get_policy(), decisions


def main(path="policy.npz", seconds="300", tasks="lift", worlds="", device=""):
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    count = int(worlds or (4096 if device.startswith("cuda") else 64))
    actor, decisions = learn(float(seconds), count, device, tasks.split(","))
    save(actor, path)
    print(f"{decisions} decisions; policy in {path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
