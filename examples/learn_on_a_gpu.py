"""Learn to grasp from scratch in thousands of worlds: pip install 'mjtactile[learn,warp]'

    python examples/learn_on_a_gpu.py policy.npz 300                       # seconds
    python examples/learn_on_a_gpu.py policy.npz 900 lift,pour,shake,bump  # further, tasks by turns
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

Learning continues from an existing policy file. The learner is PPO of rsl-rl-lib, which mjlab and
Isaac Lab use, too, with tensors that share memory with the worlds. The last command evaluates the
policy with everything simulated. On a CPU, it takes coarse membranes and an hour of one core.
"""

import sys
import time
from pathlib import Path

import torch  # pyright: ignore[reportMissingImports]
from rsl_rl.runners import OnPolicyRunner  # pyright: ignore[reportMissingImports]

from mjtactile.gym.rsl_rl_worlds import RslRlWorlds, load_actor, save_actor

COARSE = {"nodes": (9, 7), "timestep": 4.2e-3}  # a tenth of the time; + 8 % force
TASK = {"object": "random", "randomization": "default", "reward": "progress"}
TIME_LIMIT = {"lift": 12.0, "other": 25.0}  # of a grasp, s
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
FURTHER = LEARNER | {  # of a policy that is learned further: less noise, smaller steps
    "actor": LEARNER["actor"]
    | {"distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.2}},
    "algorithm": LEARNER["algorithm"]
    | {"learning_rate": 3e-4, "entropy_coef": 0.0, "schedule": "fixed"},
}


def learn(seconds, worlds, device, tasks=("lift",), seed=0, path=None, **changed):
    """Return the learned actor, and the number of decisions. Each task has its own worlds, and the
    tasks alternate. Learning continues from a policy at `path`, which is saved with each report."""
    torch.manual_seed(seed)
    how = TASK | (COARSE if device == "cpu" else {}) | changed
    envs = {}
    for task in tasks:
        limit = TIME_LIMIT.get(task, TIME_LIMIT["other"])
        envs[task] = RslRlWorlds(worlds, device, how | {"task": task, "time_limit": limit})
    continued = path is not None and Path(path).exists()
    settings = dict(FURTHER if continued else LEARNER)
    runner = OnPolicyRunner(envs[tasks[0]], settings, device=device)
    actor = runner.alg.get_policy()
    if continued:
        load_actor(actor, path)
    start = reported = time.monotonic()
    decisions = 0
    while time.monotonic() < start + seconds:
        actor.requires_grad_(not continued or decisions > 0)  # the critic learns first
        for env in envs.values():
            runner.env = env
            runner.learn(1)
            decisions += worlds * settings["num_steps_per_env"]
        if time.monotonic() > reported + 10:
            reported = time.monotonic()
            text = "; ".join(f"{task}: {env.report()}" for task, env in envs.items())
            print(f"{reported - start:.0f} s, {decisions} decisions; {text}", flush=True)
            if path is not None:
                save_actor(actor, path)
    for env in envs.values():
        env.worlds.close()
    return actor, decisions


def main(path="policy.npz", seconds="300", tasks="lift", worlds="", device=""):
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    count = int(worlds or (4096 if device.startswith("cuda") else 64))
    actor, decisions = learn(float(seconds), count, device, tasks.split(","), path=path)
    save_actor(actor, path)
    print(f"{decisions} decisions; policy in {path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
