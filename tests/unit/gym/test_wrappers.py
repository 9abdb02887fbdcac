"""Tests of the observations and actions of a stock learner, and of the file made from its
network."""

import runpy
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.policy import policy_bounds
from mjtactile.gym.wrappers import (
    MIDDLE,
    SCALE,
    SPAN,
    ActionRepeatScaling,
    policy_layers,
    save_policy,
)

CHECKOUT = Path(__file__).resolve().parents[3]


class Counted(gymnasium.Env):
    """Environment that rewards 1, 2, 3, and -1 at its end. Its observations are twice the value
    that a learner gets as 1."""

    def __init__(self):
        maximum = policy_bounds(2).astype(np.float32)
        self.observation_space = gymnasium.spaces.Box(-maximum, maximum, dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), dtype=np.float64)

    def reset(self, *, seed=None, options=None):
        self.actions = []
        return 2 * SCALE, {}

    def step(self, action):
        self.actions.append(action)
        n = len(self.actions)
        return 2 * SCALE, -1.0 if n == 4 else float(n), n == 4, False, {}


def test_an_action_is_repeated_and_an_early_end_has_the_stated_reward():
    env = ActionRepeatScaling(Counted(), steps=3, fear=0.3)
    shown, _ = env.reset()
    np.testing.assert_array_equal(shown, 2)
    first = env.step(np.zeros(3))
    assert first[1:4] == (1 + 2 + 3, False, False)
    np.testing.assert_array_equal(env.unwrapped.actions, [MIDDLE] * 3)
    # the second decision ends after one step of three
    assert env.step(np.ones(3))[1:4] == (-0.3, True, False)
    assert len(env.unwrapped.actions) == 4


def test_the_smallest_and_the_largest_action_are_the_environments_own():
    env = ActionRepeatScaling(Counted())
    env.reset()
    for end, own in ((env.action_space.low, -1.0), (env.action_space.high, 1.0)):
        env.step(end)
        assert env.unwrapped.actions[-1] == pytest.approx(own)


@pytest.fixture(params=[(len(SCALE), 3), (len(SCALE), 8, 5, 3)], ids=["one layer", "three layers"])
def saved(request, tmp_path):
    """Provide random layers of a network, and the file to which they were saved."""
    rng = np.random.default_rng(0)
    layers = [
        (rng.normal(size=(b, a)), rng.normal(size=b))
        for a, b in zip(request.param[:-1], request.param[1:], strict=True)
    ]
    path = tmp_path / "policy.npz"
    save_policy(path, layers, activation="tanh")
    return layers, path


def test_a_file_acts_as_the_network_behind_the_scales(saved, monkeypatch):
    layers, path = saved
    rng = np.random.default_rng(1)
    monkeypatch.setenv("MJTACTILE_POLICY", str(path))
    controller = runpy.run_path(str(CHECKOUT / "controllers/policy.py"))
    for shown in rng.normal(size=(5, len(SCALE))) * SCALE:
        x = shown / SCALE
        for k, (weights, biases) in enumerate(layers):
            x = weights @ (np.tanh(x) if k else x) + biases
        # the same sums in another order
        np.testing.assert_allclose(controller["load"](path)(shown), MIDDLE + SPAN * x, rtol=1e-9)


def test_layers_of_a_file_are_the_saved_layers(saved):
    layers, path = saved
    for found, own in zip(policy_layers(path), layers, strict=True):
        for one, other in zip(found, own, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)  # rounding of the scales
    with pytest.raises(InputError, match="no such file"):
        policy_layers(path.with_name("other.npz"))
