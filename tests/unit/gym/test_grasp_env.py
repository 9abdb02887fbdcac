"""Tests of the environment: rules of Gymnasium, bit-identical resets, and the scoring of
`evaluate`."""

import functools
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import mjtactile.gym
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.policy import fraction_released, policy_observation_names
from mjtactile.core.types import Command
from mjtactile.rig.registry import build_rig
from mjtactile.sim import ground_truth

CLOSE = np.array([-1.0, 0.0, 0.0], np.float32)
GRIP = np.array([-0.05, 0.0, 0.5], np.float32)
SAMPLED = "-mesh,-pipeline"
FORCE = policy_observation_names().index("finger1.force_normal_N")


def make(**how):
    return gymnasium.make(mjtactile.gym.ID, **how)


@pytest.fixture(scope="module")
def env():
    with make() as made:
        yield made


def test_the_example_of_the_page(monkeypatch, capsys):
    """The example of the page runs unchanged, with 0.4 s of time instead of twenty seconds."""
    page = (Path(__file__).resolve().parents[3] / "docs/how-to/train.md").read_text()
    monkeypatch.setattr(gymnasium, "make", functools.partial(gymnasium.make, time_limit=0.4))
    exec(page.partition("```python\n")[2].partition("```")[0], {})
    # the force in N and more follow. Nothing was touched; the gripper may rise empty and come down
    # within that time
    assert capsys.readouterr().out.startswith(("out of time 0", "dropped 0"))


def roll(env, seed, actions):
    """Return all observations, and the values of the last step."""
    shown = [env.reset(seed=seed)[0]]
    last: list[Any] = []
    info: dict[str, Any] = {}
    for action in actions:
        *last, info = env.step(action)
        shown.append(last[0])
        if last[2] or last[3]:
            break
    return np.array(shown), last, info


@pytest.mark.filterwarnings("ignore:.*A Box observation space:UserWarning")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("observation", "effects"),
    [("wrench", SAMPLED), ("markers", "-mesh,-images"), ("image", "-mesh")],
)
def test_the_check_of_gymnasium_passes(observation, effects):
    """Spaces, seeds, determinism of reset and step; with images also render."""
    how = {"render_mode": "rgb_array"} if observation == "image" else {}
    env = make(observation=observation, effects=effects, **how)
    check_env(env.unwrapped, skip_render_check=not how)


def test_the_name_is_found_by_its_module():
    """In a process that has not imported it."""
    code = "import gymnasium; gymnasium.make('mjtactile.gym:mjtactile/Grasp-v0', object='moon')"
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert "InputError: moon: unknown object" in ended.stderr


@pytest.mark.slow
def test_a_seed_is_the_same_episode_whatever_came_before(env):
    """Bit for bit up to and through contact: after another episode, and in a new environment with a
    new model."""
    actions = [CLOSE] * 29 + [GRIP] * 3
    first, _, _ = roll(env, 3, actions)
    assert first[-1, FORCE] > 0.1  # force in N: in contact
    other, _, _ = roll(env, 4, actions[:5])
    again, _, _ = roll(env, 3, actions)
    np.testing.assert_array_equal(again, first)
    assert np.abs(other - first[:6]).max() > 1e-5
    with make() as fresh:
        np.testing.assert_array_equal(roll(fresh, 3, actions)[0], first)


def test_reset_does_not_compile(env, monkeypatch):
    import mujoco

    monkeypatch.setattr(mujoco.MjSpec, "compile", None)  # would raise
    env.reset(seed=8)


def test_a_reset_object_has_its_initial_pose(env):
    """A moved egg and one compiled at its position have the same pose and cup at rest, within
    micrometers."""
    env.reset(seed=7)
    moved = env.unwrapped._rig.scene
    rig = build_rig("sim", load_sensor("dense"), seed=7)
    rig.clock.wait_until(moved.time)
    p_old, q_old = ground_truth.object_pose(rig.scene, None)
    p_new, q_new = ground_truth.object_pose(moved, None)
    rig.close()
    np.testing.assert_allclose(p_new, p_old, atol=5e-6)  # position, m
    assert abs(np.dot(q_new, q_old)) > 1 - 1e-6
    for name in ("pos", "quat"):
        cup = [getattr(world.model.body("object/cup"), name) for world in (moved, rig.scene)]
        np.testing.assert_allclose(cup[0] * np.sign(cup[0] @ cup[1]), cup[1], atol=1e-12)


def test_a_crushed_egg_ends_the_episode():
    with make(effects=SAMPLED) as sampled:
        _, (_, reward, terminated, truncated), info = roll(sampled, 0, [CLOSE] * 60)
        assert terminated and not truncated and reward == -1.0 and info["outcome"] == "crushed"
        assert info["peak_force_true_N"] > info["break_force_N"] == 2.5
        with pytest.raises(gymnasium.error.ResetNeeded):
            sampled.unwrapped.step(CLOSE)


def test_a_gripper_that_rises_without_the_object_has_dropped_it(env):
    up = np.array([0.0, 0.0, 1.0], np.float32)
    _, (_, reward, terminated, _), info = roll(env, 0, [up] * 60)
    assert (
        terminated
        and reward == -1.0
        and info["outcome"] == "dropped"
        and info["peak_force_true_N"] == 0.0
    )


def test_an_empty_gripper_has_no_reward_for_releasing():
    """An empty gripper that rises slightly and lowers open gets no reward for release.

    An object that was never held counts as dropped.
    """
    rise, wait = (np.array([0.0, -0.75, lift], np.float32) for lift in (0.5, -1.0))
    paid = []
    with make(effects=SAMPLED, reward="progress") as sampled:
        sampled.reset(seed=0)
        for action in [rise] * 6 + [wait] * 60:
            _, reward, terminated, _, info = sampled.step(action)
            paid.append(reward)
            if terminated:
                break
    assert info["outcome"] == "dropped" and sum(paid) == -1.0


def test_reward_increases_with_the_release_distance():
    """The release reward is proportional to the opening: zero at a grip's goal 4 mm ahead of the
    jaws, one at 8 mm beyond them."""
    for opening, fraction in ((0.036, 0.0), (0.042, 0.5), (0.048, 1.0)):
        sent = Command(opening, 1.0, 0.0, "release", {"grip_opening": 0.040}, "", None)
        assert fraction_released(sent) == pytest.approx(fraction)


def test_random_objects_are_those_of_the_seeds():
    with (
        make(object="random", effects=SAMPLED) as random_objects,
        make(object="random:8", effects=SAMPLED) as one,
    ):
        again = [random_objects.reset(seed=seed)[1]["break_force_N"] for seed in (7, 8, 7)]
        assert again[0] == again[2] != again[1] == one.reset(seed=8)[1]["break_force_N"]


def test_an_episode_ends_at_its_time_limit():
    with make(time_limit=0.3) as short:
        shown, (_, reward, terminated, truncated), info = roll(
            short, 0, [np.zeros(3, np.float32)] * 30
        )
    assert (
        len(shown) == 1 + 9
        and truncated
        and not terminated
        and reward == 0.0
        and info["outcome"] == "out of time"
    )


def test_observations_contain_no_ground_truth(env):
    names = policy_observation_names()
    assert (
        not [name for name in names if "true" in name]
        and len(names) == env.observation_space.shape[0] == 30
    )


@pytest.mark.parametrize("mode", ["sync", pytest.param("async", marks=pytest.mark.slow)])
def test_vectorized_environments_are_independent(mode):
    envs = gymnasium.make_vec(
        mjtactile.gym.ID, num_envs=2, vectorization_mode=mode, effects=SAMPLED
    )
    shown, _ = envs.reset(seed=5)
    for _ in range(3):
        shown, *_ = envs.step(np.stack([CLOSE, CLOSE]))
    envs.close()
    with make(effects=SAMPLED) as env:
        for k in range(2):
            np.testing.assert_array_equal(shown[k], roll(env, 5 + k, [CLOSE] * 3)[0][-1])


def test_a_randomized_world_is_rebuilt():
    with make(randomization="default", effects=SAMPLED) as randomized:
        infos = [randomized.reset(seed=seed)[1] for seed in (1, 2, 1)]
    assert infos[0]["randomized"] == infos[2]["randomized"] != infos[1]["randomized"]


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"observation": "pixels"}, "observation: 'pixels' .valid: wrench, markers, image"),
        ({"object": "moon"}, "unknown object"),
        ({"rig": "nowhere"}, "unknown rig"),
        # its cameras, which are not connected, are not opened
        ({"rig": "two_xm430"}, "'two_xm430' is not a simulated rig .valid: sim"),
    ],
)
def test_wrong_names_are_reported_in_one_line(how, text):
    with pytest.raises(InputError, match=text):
        make(**how)


def episodes(count, seed, steps, **how):
    """Return the observations of the first of `count` environments over `steps`, past the end of an
    episode."""
    envs = gymnasium.make_vec(mjtactile.gym.ID, num_envs=count, effects=SAMPLED, **how)
    shown = [envs.reset(seed=seed)[0][0]]
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1, 0.2, (steps, 3)).astype(np.float32)
    for action in actions:
        shown.append(envs.step(np.repeat(action[None], count, axis=0))[0][0])
    envs.close()
    return np.array(shown)


@pytest.mark.parametrize("randomization", ["none", pytest.param("default", marks=pytest.mark.slow)])
def test_results_are_independent_of_the_number_of_environments(randomization):
    """Bit for bit, in threads, over the end of an episode: the squeezed egg breaks."""
    alone = episodes(1, 5, 60, randomization=randomization, threads=1)
    np.testing.assert_array_equal(episodes(2, 5, 60, randomization=randomization, threads=2), alone)
    assert len(np.unique(alone[:, FORCE])) > 10  # it was touched


def test_sampled_touch_states_its_level_and_starts_again_as_in_a_new_world():
    """Sampled touch reports its level, and a repeated seed gives the same episode as a new world.

    This holds after another episode, with randomized parameters sampled again.
    """
    actions = [CLOSE] * 30
    for randomization in ("none", "default"):
        with (
            make(effects=SAMPLED, randomization=randomization) as first,
            make(effects=SAMPLED, randomization=randomization) as other,
        ):
            shown, _, info = roll(first, 3, actions)
            assert info["mesh"] is info["pipeline"] is info["images"] is False
            roll(other, 4, actions[:20])
            np.testing.assert_array_equal(roll(other, 3, actions)[0], shown)
