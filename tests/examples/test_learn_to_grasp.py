"""Test that a saved policy has the actions of the learner."""

import functools
import runpy
from pathlib import Path

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.policy_file import load_policy
from mjtactile.gym.wrappers import MIDDLE, SCALE, SPAN, policy_layers

CHECKOUT = Path(__file__).resolve().parents[2]


def test_the_ten_lines_of_the_page_learn(tmp_path, monkeypatch):
    """The code on the page learns, unchanged except for 16 steps instead of 100 000."""
    learner = pytest.importorskip("stable_baselines3")
    page = (CHECKOUT / "docs/how-to/train.md").read_text()
    lines = page.split("```python\n")[2].partition("```")[0]
    short = functools.partial(learner.PPO, n_steps=16, batch_size=16)
    monkeypatch.setattr(learner, "PPO", short)
    monkeypatch.chdir(tmp_path)
    exec(lines.replace("100_000", "16"), {})
    assert (tmp_path / "policy.zip").is_file()


def test_a_saved_policy_acts_as_the_learner_does(tmp_path, monkeypatch):
    """Actions agree in single precision, through scale and layers."""
    learner = pytest.importorskip("stable_baselines3")
    example = runpy.run_path(str(CHECKOUT / "examples/learn_to_grasp.py"))
    env = example["make"]()
    model = learner.PPO("MlpPolicy", env, policy_kwargs={"net_arch": [8, 8]}, device="cpu", seed=0)
    path = tmp_path / "policy.npz"
    example["save"](model, path)
    monkeypatch.setenv("MJTACTILE_POLICY", str(path))
    controller = runpy.run_path(str(CHECKOUT / "controllers/policy.py"))
    rng = np.random.default_rng(0)
    for shown in rng.uniform(-1, 1, (5, len(SCALE))) * SCALE:
        requested, _ = model.predict((shown / SCALE).astype(np.float32), deterministic=True)
        np.testing.assert_allclose(
            np.clip(controller["load"](path)(shown), -1, 1), MIDDLE + SPAN * requested, atol=1e-5
        )
    env.close()


@pytest.mark.slow(60)
def test_a_policy_learned_in_many_worlds_is_saved_as_the_learner_acts(tmp_path):
    """Two worlds of each of two tasks, and one update by each, on the CPU; to single precision."""
    pytest.importorskip("rsl_rl")
    import torch  # pyright: ignore[reportMissingImports]

    from mjtactile.gym.rsl_rl_worlds import linear_layers, save_actor

    example = runpy.run_path(str(CHECKOUT / "examples/learn_on_a_gpu.py"))
    example["LEARNER"]["num_steps_per_env"] = 2
    actor, decisions = example["learn"](1e-3, 2, "cpu", ["lift", "shake"], object="egg")
    assert decisions == 8
    save_actor(actor, tmp_path / "policy.npz")
    policy = load_policy(tmp_path / "policy.npz")
    rng = np.random.default_rng(0)
    for shown in rng.uniform(-1, 1, (5, len(SCALE))) * SCALE:
        scaled = torch.tensor((shown / SCALE).astype(np.float32))
        requested = actor.mlp(scaled).detach().numpy()
        np.testing.assert_allclose(policy(shown), MIDDLE + SPAN * requested, atol=1e-5)
    # learned further: the critic learns first, so that the first round changes no weight
    path = tmp_path / "policy.npz"
    further, _ = example["learn"](1e-3, 2, "cpu", ["lift"], object="egg", path=path)
    for layer, saved in zip(*map(linear_layers, (further, actor)), strict=True):
        np.testing.assert_allclose(layer.weight.detach(), saved.weight.detach(), atol=1e-6)


@pytest.mark.slow(60)
def test_a_policy_with_a_memory_is_learned_from_the_adaptive_controller(tmp_path):
    """The teacher acts in one round and the policy in another, one episode each."""
    pytest.importorskip("torch")
    example = runpy.run_path(str(CHECKOUT / "examples/learn_from_adaptive.py"))
    example["main"].__globals__.update(EPISODES=(1, 1), EPOCHS=1, TIME_LIMIT=3.0)
    path = tmp_path / "policy.npz"
    example["main"](str(path), "2")
    unit = load_policy(path).unit
    assert unit is not None and unit.inputs == 38
    with pytest.raises(InputError, match="has a memory"):
        policy_layers(path)
