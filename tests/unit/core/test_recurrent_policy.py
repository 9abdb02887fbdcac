"""Tests of policies with a memory: the recurrent unit, its state, its file and its observation."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.controller_state import plain
from mjtactile.core.errors import InputError
from mjtactile.core.policy import command_from_action, policy_observation
from mjtactile.core.policy_file import load_policy, save_policy
from mjtactile.core.recurrent_policy import (
    SLIP_MAX,
    STATE,
    RecurrentUnit,
    recurrent_observation,
    recurrent_observation_names,
)
from mjtactile.core.types import Slip, SlipState, TaskGoal
from tests.unit.core.test_policy import seen

N = 40  # entries of two fingers
UNITS = 3
RNG = np.random.default_rng(0)
UNIT = RecurrentUnit(
    0.1 * RNG.normal(size=(3 * UNITS, 2 * N)),
    RNG.normal(size=(3 * UNITS, UNITS)),
    RNG.normal(size=3 * UNITS),
    RNG.normal(size=3 * UNITS),
)
LAYERS = [(RNG.normal(size=(5, UNITS + 2 * N)), np.ones(5)), (RNG.normal(size=(3, 5)), np.zeros(3))]


def sliding(distance, state: SlipState = "slipping", **goal):
    """An observation in which the second finger slides."""
    observation = seen((0.3, 0.4))
    slip = Slip(state, np.zeros(2), distance, 0.0)
    touch = (observation.touch[0], replace(observation.touch[1], slip=slip))
    return replace(observation, touch=touch, goal=TaskGoal(**goal))


def state_by_hand(inputs, state):
    """Cho et al. (2014), one unit after the other, with the reset gate as in PyTorch."""
    new = []
    for k in range(UNITS):
        gates = []
        for row in (k, UNITS + k):
            total = UNIT.gru_input_weights[row] @ inputs + UNIT.gru_input_biases[row]
            total += UNIT.gru_state_weights[row] @ state + UNIT.gru_state_biases[row]
            gates.append(1 / (1 + math.exp(-total)))
        reset, update = gates
        row = 2 * UNITS + k
        old = UNIT.gru_state_weights[row] @ state + UNIT.gru_state_biases[row]
        total = UNIT.gru_input_weights[row] @ inputs + UNIT.gru_input_biases[row] + reset * old
        new.append((1 - update) * math.tanh(total) + update * state[k])
    return np.array(new)


def test_the_state_follows_the_equations_over_three_observations():
    """Vector and change go in; the first change is zero. Both are the same sums."""
    vectors = RNG.normal(size=(3, N))
    kept = None
    state = np.zeros(UNITS)
    for before, vector in zip(vectors[[0, 0, 1]], vectors, strict=True):
        inputs = np.concatenate([vector, vector - before])
        state = state_by_hand(inputs, state)
        features, kept = UNIT.after(vector, kept)
        np.testing.assert_allclose(features, np.concatenate([state, inputs]), rtol=1e-12)


def test_a_file_is_the_unit_and_the_layers_behind_the_scales(tmp_path):
    """Scales by hand against those of the file; both are sums of the same products."""
    center = RNG.normal(size=2 * N)
    scale = np.where(np.arange(2 * N) == N + 4, np.inf, 2.0)  # one change is not used
    path = tmp_path / "policy.npz"
    save_policy(
        path,
        LAYERS,
        activation="tanh",
        unit=UNIT,
        input_center=center,
        input_scale=scale,
        output_center=0.1,
        output_scale=0.5,
    )
    policy = load_policy(path)
    assert policy.unit is not None
    state, kept = np.zeros(UNITS), None
    before = vector = RNG.normal(size=N)
    for _ in range(2):
        inputs = (np.concatenate([vector, vector - before]) - center) / scale
        state = state_by_hand(inputs, state)
        inner = np.tanh(LAYERS[0][0] @ np.concatenate([state, inputs]) + 1)
        features, kept = policy.unit.after(vector, kept)
        expected = 0.1 + 0.5 * (LAYERS[1][0] @ inner)
        np.testing.assert_allclose(policy(features), expected, rtol=1e-9)
        before, vector = vector, RNG.normal(size=N)


def test_the_command_contains_the_memory(tmp_path):
    """Same observation, different past, another action; a recording of the memory is complete."""
    path = tmp_path / "policy.npz"
    layers = [(0.05 * w, b) for w, b in LAYERS]
    save_policy(path, layers, activation="tanh", unit=UNIT)
    policy = load_policy(path)
    first = policy.command(sliding(0.001))
    again = policy.command(replace(sliding(0.001), command=first))
    assert first.memory[STATE] != again.memory[STATE]
    assert first.force_limit != again.force_limit
    left, omitted = plain(first.memory)
    assert not omitted and json.loads(json.dumps(left[STATE])) == first.memory[STATE]
    # phase and clocks are those of `command_from_action`
    other = {k: v for k, v in first.memory.items() if k != STATE}
    assert other == command_from_action(sliding(0.001), [0, 0, 0]).memory


def test_slip_and_announced_loads_are_named_and_bounded():
    vector = recurrent_observation(sliding(1.0, push=0.3, acceleration=4.0))
    named = dict(zip(recurrent_observation_names(), vector.tolist(), strict=True))
    assert named["finger1.slip_distance_m"] == named["finger1.slipping"] == 0  # no slip estimate
    assert (named["finger2.slipping"], named["finger2.incipient"]) == (1, 0)
    assert named["finger2.slip_distance_m"] == np.float32(SLIP_MAX)
    assert (named["push_N"], named["acceleration_m_s2"]) == (np.float32(0.3), 4)
    assert (named["place_height_m"], named["handover"]) == (0, 0)
    plain_vector = policy_observation(sliding(1.0))
    np.testing.assert_array_equal(vector[: len(plain_vector)], plain_vector)
    unknown = recurrent_observation(sliding(math.nan, "incipient"))
    named = dict(zip(recurrent_observation_names(), unknown.tolist(), strict=True))
    assert (named["finger2.incipient"], named["finger2.slip_distance_m"]) == (1, 0)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"gru_state_biases": None}, "gru_state_biases: is missing"),
        ({"gru_state_weights": np.ones((9, 4))}, r"shape \(9, 4\) does not.*valid: \(9, 3\)"),
        ({"gru_input_weights": np.ones((8, 80))}, r"gru_input_weights: the shape \(8, 80\)"),
        ({"gru_input_weights": np.ones((9, 30))}, "gru_input_weights: has 30 columns .valid: 58, "),
        ({"gru_input_biases": np.ones(8)}, r"gru_input_biases: the shape \(8,\).*valid: \(9,\)"),
        ({"gru_input_biases": np.full(9, np.nan)}, "gru_input_biases: has values that are not fin"),
        ({"gru_input_biases": np.array(["a"] * 9)}, "has arrays that are not numeric"),
        ({"w0": np.ones((5, 30))}, r"layers\[0\]: weights \(5, 30\).*valid: 83 for 2 fingers"),
    ],
)
def test_a_wrong_unit_is_reported_in_one_line(tmp_path, changed, text):
    path = tmp_path / "policy.npz"
    (w0, b0), (w1, b1) = LAYERS
    arrays = dict(w0=w0, b0=b0, w1=w1, b1=b1, activation=np.array("tanh")) | vars(UNIT) | changed
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(InputError, match=text) as caught:
        load_policy(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_another_rig_is_named_at_the_step(tmp_path):
    path = tmp_path / "policy.npz"
    save_policy(path, LAYERS, activation="tanh", unit=UNIT)
    observation = sliding(0.0)
    three = replace(observation, touch=(*observation.touch, observation.touch[0]))
    text = r"has 51 values \(of 3 fingers\), but the policy was trained with 40 values \(of 2 fing"
    with pytest.raises(InputError, match=text):
        load_policy(path).command(three)
