"""Tests of imitation: labels of the teacher, inputs of the network, and the fitted actor's file."""

from dataclasses import replace

import numpy as np
import pytest

import mjtactile
from mjtactile.core.policy import command_from_action
from mjtactile.core.policy_file import load_policy
from mjtactile.core.recurrent_policy import recurrent_observation_names
from mjtactile.core.types import Command, TaskGoal
from mjtactile.gym.imitation import (
    INPUT_SCALE,
    ask_teacher,
    recurrent_observation,
    scaled_inputs,
    teacher_action,
)
from tests.unit.core.test_policy import seen

NAMES = recurrent_observation_names()


def at(phase, height, **memory):
    """An observation in which the policy grips, in this phase and at this height."""
    last = Command(0.05, 4.0, height, phase, {"grip_opening": 0.05, **memory})
    return seen((0.4, 0.4), 0.05, height, last)


def test_the_action_repeats_the_teachers_command():
    observation = at("hold", 0.04)
    teacher = replace(observation.command, opening=0.0495, force_limit=5.0, phase="hold")
    command = command_from_action(observation, teacher_action(observation, teacher))
    assert (command.opening, command.force_limit, command.lift_height) == pytest.approx(
        (0.0495, 5.0, 0.04)
    )


@pytest.mark.parametrize("phase", ["release", "done"])
def test_a_teacher_that_releases_early_does_not_open_the_policys_jaws(phase):
    """The policy is in its hold, which ends by time: jaws that open count as a loss."""
    observation = at("hold", 0.04)
    teacher = replace(observation.command, opening=0.06, phase=phase)
    command = command_from_action(observation, teacher_action(observation, teacher))
    assert (command.opening, command.lift_height) == (0.05, 0.04)


@pytest.mark.parametrize(
    ("phase", "goal"), [("lower", TaskGoal()), ("hold", TaskGoal(handover=True))]
)
def test_the_policy_releases_with_its_teacher(phase, goal):
    """The table is higher than specified, or the object is pulled: opening starts the release."""
    observation = replace(at(phase, 0.03), goal=goal)
    teacher = replace(observation.command, opening=0.051, phase="release")
    command = command_from_action(observation, teacher_action(observation, teacher))
    assert command.phase == phase and command.opening > 0.0501
    opened = replace(observation, command=replace(command, opening=0.0511))
    assert command_from_action(opened, teacher_action(opened, teacher)).phase == "release"


def test_a_lowered_policy_opens_before_its_teacher():
    observation = at("lower", 0.0005)
    teacher = replace(observation.command, lift_height=0.0, phase="lower")
    action = teacher_action(observation, teacher)
    assert command_from_action(observation, action).phase == "release"
    assert (action[0], action[2]) == (1.0, 0.0)


def test_the_teacher_continues_its_own_memory_from_the_policys_goals():
    class Teacher:
        def step(self, observation):
            assert "goal" not in observation.command.memory  # it starts from the sent opening
            memory = {"count": observation.command.memory.get("count", 0) + 1, "goal": 0.03}
            return replace(observation.command, phase="hold", memory=memory)

    observation = at("lift", 0.02)
    first = ask_teacher(Teacher(), observation, None)
    again = ask_teacher(Teacher(), at("lower", 0.03), first)
    assert again.memory["count"] == first.memory["count"] + 1
    assert (again.phase, again.lift_height) == ("hold", 0.03)


def test_inputs_are_values_and_their_changes():
    vectors = np.zeros((2, len(NAMES)))
    force, opening, speed = (
        NAMES.index(name) for name in ("finger2.force_normal_N", "opening_m", "speed_m_s")
    )
    vectors[1, [force, opening, speed]] = 0.3, 0.04, 1.0
    first, second = scaled_inputs(vectors)
    assert not first.any()
    changes = len(NAMES)
    assert second[[force, changes + force]] == pytest.approx([0.3, 10.0])
    assert second[[opening, changes + opening]] == pytest.approx([1.0, 80.0])
    assert second[speed] == 0 and np.isinf(INPUT_SCALE[speed])  # differs on a real servo


@pytest.mark.slow
def test_the_teachers_actions_alone_grasp_lift_and_set_down():
    """The action set is sufficient for `adaptive`: its labels, executed, end with "done"."""
    teacher = mjtactile.load_controller("adaptive")
    scenario = mjtactile.Scenario(effects="-mesh,-pipeline", seed=3)
    command = None
    with mjtactile.open_session(scenario, workers=0) as session:
        session.take_references()
        with session.steps() as control:
            for _ in range(600):
                observation = control.observe()
                command = ask_teacher(teacher, observation, command)
                action = teacher_action(observation, command)
                sent = control.send(command_from_action(observation, action))
                if sent.phase in ("done", "abort"):
                    break
    assert sent.phase == "done"


def test_a_saved_actor_acts_as_in_learning(tmp_path):
    """Whole episodes in PyTorch against the file, image by image, to single precision."""
    torch = pytest.importorskip("torch")
    from mjtactile.gym.recurrent_actor import ACTION_SCALE, RecurrentActor

    actor = RecurrentActor(estimates=2)
    actor.save(tmp_path / "policy.npz")
    policy = load_policy(tmp_path / "policy.npz")
    assert policy.unit is not None
    rng = np.random.default_rng(0)
    scale = np.where(np.isfinite(INPUT_SCALE), INPUT_SCALE, 1.0)[: len(NAMES)]
    vectors = rng.normal(size=(40, len(NAMES))) * scale
    with torch.no_grad():
        found, _ = actor(torch.as_tensor(scaled_inputs(vectors))[None])
    expected = found[0].numpy() * ACTION_SCALE
    assert np.ptp(expected[:, 0]) > 0.01  # the actions differ
    kept = None
    for vector, action in zip(vectors, expected, strict=True):
        features, kept = policy.unit.after(vector, kept)
        np.testing.assert_allclose(policy(features), action, atol=2e-5)


def test_a_fit_learns_actions_that_depend_on_the_past():
    """The action is the first force of the episode, no longer visible at its end."""
    torch = pytest.importorskip("torch")
    from mjtactile.gym.recurrent_actor import RecurrentActor, fit, imitation_loss

    rng = np.random.default_rng(0)
    episodes = []
    for length in rng.integers(4, 7, 32):
        inputs = np.zeros((length, len(INPUT_SCALE)), np.float32)
        inputs[0, 2] = rng.choice([-1.0, 1.0])
        actions = np.full((length, 3), 0.05 * inputs[0, 2], np.float32)
        episodes.append((inputs, actions, np.zeros((length, 2), np.float32)))
    actor = RecurrentActor(estimates=2)
    with torch.no_grad():
        before = float(imitation_loss(actor, episodes))
    fit(actor, episodes, 40)
    with torch.no_grad():
        assert float(imitation_loss(actor, episodes)) < 0.05 * before


def test_the_observation_is_that_of_the_file():
    assert len(recurrent_observation(at("hold", 0.04))) == len(NAMES) == len(INPUT_SCALE) / 2
