"""Learn to grasp from the controller `adaptive`, by imitation: pip install 'mjtactile[learn]'

    python examples/learn_from_adaptive.py policy.npz 10    # rounds
    MJTACTILE_POLICY=policy.npz mjtactile evaluate --controller policy --objects random

The policy, a recurrent network, observes sensor data only. In the first round the teacher acts,
with disturbances. In each further round the policy acts, and the teacher adds what it would
command in the same states. Touch is synthetic (`-mesh,-pipeline`).
"""

import sys
from dataclasses import replace
from typing import Any

import numpy as np

import mjtactile
from mjtactile.gym.imitation import (
    ask_teacher,
    recurrent_observation,
    scaled_inputs,
    teacher_action,
)
from mjtactile.gym.recurrent_actor import RecurrentActor, fit

TASKS = ("bump", "shake", "pour", "wet", "place", "hand-over", "lift", "bump", "shake", "wet")
EPISODES = (150, 36)  # of the first round, and of each further one
EPOCHS = 12
TIME_LIMIT = 40.0  # of an episode, s
FIRST_SEED = 2_100_000  # other seeds than `evaluate`
TURN = 1.5  # mean time for which the policy, the teacher or a disturbance acts, s
DISTURBANCE = (0.03, 0.0, 0.1)  # of the teacher's actions


def load_of(command: Any):
    """Return the load on a finger that the teacher has estimated, N."""
    return max(command.memory["load"]["maximum"], 0.02)


def run_episode(teacher, task, seed, policy=None, mixed=False):
    """Return scaled inputs, actions and estimates of the teacher in one episode. `mixed`: policy
    and teacher act by turns."""
    rng = np.random.default_rng(seed)
    world = {"object": f"random:{seed}", "task": task, "randomization": "default", "seed": seed}
    scenario = mjtactile.Scenario(effects="-mesh,-pipeline", **world)
    rows, command, disturbance, acts = [], None, np.zeros(3), policy is not None
    with mjtactile.open_session(scenario, workers=0) as session:
        session.take_references()
        with session.steps() as control:
            while len(rows) * session.rig.period < TIME_LIMIT:
                now = control.observe()
                command = ask_teacher(teacher, now, command)
                if command.phase == "abort" or "lost" in command.memory:
                    break
                action = teacher_action(now, command)
                estimates = np.log([command.memory["target"], load_of(command)])
                rows.append((recurrent_observation(now), action, estimates))
                if rng.random() < session.rig.period / TURN:
                    acts ^= mixed
                    disturbance = rng.normal(size=3) * DISTURBANCE * (policy is None)
                if now.command.phase not in ("approach", "close"):
                    action = action + disturbance
                request = mjtactile.command_from_action(now, action)
                if policy is not None:
                    own = policy.command(now)
                    request = own if acts else replace(request, memory=own.memory)
                if control.send(request).phase in ("done", "abort"):
                    break
    vectors, actions, estimates = (np.array(part, np.float32) for part in zip(*rows, strict=True))
    return scaled_inputs(vectors), actions, estimates


def main(path="policy.npz", rounds="10"):
    teacher = mjtactile.load_controller("adaptive")
    actor, episodes, policy = RecurrentActor(estimates=2, seed=0), [], None
    for turn in range(int(rounds)):
        for _ in range(EPISODES[turn > 0]):
            seed = FIRST_SEED + len(episodes)
            task = TASKS[seed % len(TASKS)]
            episodes.append(run_episode(teacher, task, seed, policy, mixed=seed % 3 == 0))
            print(f"{len(episodes)} episodes", end="\r", flush=True)
        print(f"{len(episodes)} episodes; loss {fit(actor, episodes, EPOCHS):.4f}", flush=True)
        actor.save(path)
        policy = mjtactile.load_policy(path)


if __name__ == "__main__":
    main(*sys.argv[1:])
