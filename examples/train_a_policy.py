"""Policy learned from recorded grasps of `gentle` by linear regression, without a training
framework.

    python examples/train_a_policy.py policy.npz 16          # from sixteen grasps with other seeds
    MJTACTILE_POLICY=policy.npz mjtactile grasp --controller policy
"""

import sys
from dataclasses import replace

import numpy as np

import mjtactile

DESIGN = mjtactile.load_sensor("dense")
TEACHER = mjtactile.load_controller("gentle")
RIDGE = 1e-4
# These differ on a real servo: its current includes friction in its gears, and it lags its goal.
OMITTED = np.isin(
    mjtactile.policy_observation_names(), ["speed_m_s", "effort_N", "goal_ahead_m", "force_limit_N"]
)


def record_grasp(seed):
    """Return the policy's observations (n, k) and the teacher's actions (n, 3) in one grasp of the
    egg."""
    observations = []
    actions = []
    own_commands = []  # of the policy: its phases differ from the teacher's
    with mjtactile.open_session("sim", DESIGN, object_name="egg", seed=seed) as session:

        def on_cycle(cycle):
            last = own_commands[-1] if own_commands else cycle.last
            last = replace(cycle.last, phase=last.phase, memory=last.memory)
            observation = mjtactile.Observation(
                cycle.time, session.rig.period, cycle.touch, cycle.gripper, cycle.valves, last
            )
            action = mjtactile.action_from_commands(cycle.last, cycle.sent, session.rig.period)
            own_commands.append(mjtactile.command_from_action(observation, action))
            observations.append(np.where(OMITTED, 0.0, mjtactile.policy_observation(observation)))
            actions.append(action)

        session.take_references()
        session.run(TEACHER, time_limit=60, on_cycle=on_cycle)
    return np.array(observations, float), np.array(actions)


def fit(observations, actions):
    """Return weights (3, k) and offsets (3,) of a ridge regression from observations to actions."""
    # constant inputs carry no information
    scale = np.where(observations.std(axis=0) > 1e-9, observations.std(axis=0), np.inf)
    mean = observations.mean(axis=0)
    x = (observations - mean) / scale
    w = (
        np.linalg.solve(
            x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T @ (actions - actions.mean(axis=0))
        ).T
        / scale
    )
    return w, actions.mean(axis=0) - w @ mean


def main(path="policy.npz", grasps="16", first="1000"):
    recorded = [record_grasp(int(first) + k) for k in range(int(grasps))]
    observations, actions = (np.concatenate(parts) for parts in zip(*recorded, strict=True))
    w, b = fit(observations, actions)
    mjtactile.save_policy(path, [(w, b)])
    print(
        f"{len(observations)} cycles of {grasps} grasps: actions explained within "
        f"{np.sqrt(np.mean((observations @ w.T + b - actions) ** 2)):.3f}"
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
