"""Tests of training data from recordings: they equal what a policy observes in the run."""

from dataclasses import replace

import numpy as np
import pytest

import mjtactile
from mjtactile.core.errors import InputError
from mjtactile.recording.policy_data import policy_data
from mjtactile.recording.writer import Recorder
from tests.fake_run import fake_cycle


def run(folder, count=60):
    """Record a synthetic grasp; return the observations and actions of the run itself."""
    period = 1 / 30
    shown = []
    done = []
    first = fake_cycle(0, count).sent
    last = replace(first, opening=0.06, force_limit=None, phase="approach", memory={})
    own = last
    with Recorder(folder, {"sensor": "dense", "object": "egg"}) as recorder:
        recorder.note(start_opening=0.06, start_lift_height=0.0)
        for i in range(count):
            cycle = fake_cycle(i, count, float("nan") if i == 31 else None)
            sent = replace(cycle.sent, opening=0.06 - 2e-4 * i, lift_height=3e-4 * i)
            object.__setattr__(cycle, "sent", sent)
            command = replace(last, phase=own.phase, memory=own.memory)
            observation = mjtactile.Observation(
                cycle.time, period, cycle.touch, cycle.gripper, cycle.valves, command
            )
            shown.append(mjtactile.policy_observation(observation))
            done.append(mjtactile.action_from_commands(last, sent, period))
            own = mjtactile.command_from_action(observation, done[-1])
            last = sent
            recorder.add(cycle)
    return np.array(shown), np.array(done)


def test_a_recording_has_the_observations_and_actions_of_its_run(tmp_path):
    """Numbers in a log are exact; only the period is measured from the times."""
    shown, done = run(tmp_path / "run")
    data = policy_data(tmp_path / "run")
    assert list(data.names) == mjtactile.policy_observation_names()
    np.testing.assert_allclose(data.observations, shown, atol=1e-6)
    np.testing.assert_allclose(data.actions, done, atol=1e-9)
    phases = data.observations[:, data.names.index("approach") :]
    assert (phases.sum(axis=1) == 1).all() and len(set(phases.argmax(axis=1))) > 3
    unknown = data.observations[31, data.names.index("finger1.known")]
    assert unknown == 0 and data.observations.dtype == np.float32


def test_a_cycle_before_any_force_limit_has_no_action(tmp_path):
    with Recorder(tmp_path / "run", {"sensor": "dense"}) as recorder:
        for i, limit in enumerate((None, 4.0, None)):
            cycle = fake_cycle(i)
            object.__setattr__(cycle, "sent", replace(cycle.sent, force_limit=limit))
            recorder.add(cycle)
    actions = policy_data(tmp_path / "run").actions
    assert np.isnan(actions[0]).all()
    # 4 N of 8 N is the center of the range; unchanged afterwards
    np.testing.assert_array_equal(actions[1:, 1], [0.0, 0.0])


def test_a_recording_without_cycles_is_named(tmp_path):
    with Recorder(tmp_path / "run", {"sensor": "dense"}):
        pass
    with pytest.raises(InputError, match="has no cycles"):
        policy_data(tmp_path / "run")
