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
# A real servo's are another's: its current goes into its gears, too, and it is behind its goal.
NOT_DETECTED = np.isin(
    mjtactile.policy_observation_names(), ["speed_m_s", "effort_N", "goal_ahead_m", "force_limit_N"]
)


def watch(seed):
    """Return the policy's observations (n, k) and the teacher's actions (n, 3) in one grasp of the
    egg."""
    seen = []
    done = []
    own = []
    with mjtactile.open_session("sim", DESIGN, object_name="egg", seed=seed) as session:

        def on_cycle(cycle):
            last = own[-1] if own else cycle.last
            # the policy's phases, not the teacher's
            last = replace(cycle.last, phase=last.phase, memory=last.memory)
            observation = mjtactile.Observation(
                cycle.time, session.rig.period, cycle.touch, cycle.gripper, cycle.valves, last
            )
            action = mjtactile.action_from_commands(cycle.last, cycle.sent, session.rig.period)
            own.append(mjtactile.command_from_action(observation, action))
            seen.append(np.where(NOT_DETECTED, 0.0, mjtactile.policy_observation(observation)))
            done.append(action)

        session.take_references()
        session.run(TEACHER, time_limit=60, on_cycle=on_cycle)
    return np.array(seen, float), np.array(done)


def fit(seen, done):
    """Weights (3, k) and offsets (3,) that explain the actions best, slightly biased towards
    zero."""
    # constant inputs carry no information
    scale = np.where(seen.std(axis=0) > 1e-9, seen.std(axis=0), np.inf)
    mean = seen.mean(axis=0)
    x = (seen - mean) / scale
    w = (
        np.linalg.solve(
            x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T @ (done - done.mean(axis=0))
        ).T
        / scale
    )
    return w, done.mean(axis=0) - w @ mean


def main(path="policy.npz", grasps="16", first="1000"):
    recorded = [watch(int(first) + k) for k in range(int(grasps))]
    seen, done = (np.concatenate(parts) for parts in zip(*recorded, strict=True))
    w, b = fit(seen, done)
    mjtactile.save_policy(path, [(w, b)])
    print(
        f"{len(seen)} cycles of {grasps} grasps: actions explained within "
        f"{np.sqrt(np.mean((seen @ w.T + b - done) ** 2)):.3f}"
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
