"""Tests that a policy has the same inputs and outputs everywhere, and that phases follow from touch
and position."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.policy import (
    action_from_commands,
    command_from_action,
    policy_observation,
    policy_observation_names,
)
from mjtactile.core.types import (
    Command,
    GripperState,
    Observation,
    TaskGoal,
    Touch,
    Traction,
    ValveState,
)

PERIOD = 1 / 30


def seen(forces=(0.0, 0.0), opening=0.05, height=0.0, command=None):
    def touch(force):
        wrench = [0.01, 0.02, -force, 0.001, 0.002, 0.003]
        traction = Traction([0.0], [0.0], np.zeros((1, 1, 3)), wrench, np.eye(6), 1000.0, "made up")
        return Touch(1.0, 0.0, force, 0.01, force > 0.05, traction=traction)

    command = command or Command(opening, 4.0)
    gripper = GripperState(opening, -0.01, 0.3, height)
    return Observation(
        1.0, PERIOD, tuple(map(touch, forces)), gripper, (ValveState(False),) * 2, command
    )


def test_every_number_has_its_name():
    vector = dict(
        zip(
            policy_observation_names(),
            policy_observation(seen((0.3, 0.4), 0.05, 0.01)),
            strict=True,
        )
    )
    assert vector["finger2.force_normal_N"] == np.float32(0.4) and vector[
        "finger1.tz_Nm"
    ] == np.float32(0.003)
    assert (
        vector["opening_m"] == np.float32(0.05)
        and vector["lift_height_m"] == np.float32(0.01)
        and vector["approach"] == 1
    )


def test_an_unknown_force_is_reported_as_unknown():
    observation = seen((float("nan"), 0.4))
    vector = dict(zip(policy_observation_names(), policy_observation(observation), strict=True))
    assert (vector["finger1.known"], vector["finger1.force_normal_N"], vector["finger2.known"]) == (
        0,
        0,
        1,
    )


def test_an_action_is_speeds_and_a_limit():
    command = command_from_action(seen(opening=0.05), [0.5, 0.0, 1.0])
    assert (
        command.opening == pytest.approx(0.05 + 0.5 * 0.05 * PERIOD) and command.force_limit == 4.0
    )
    assert command.lift_height == pytest.approx(0.05 * PERIOD)
    assert command_from_action(seen(), [9, 9, -9]) == command_from_action(seen(), [1, 1, -1])
    assert command_from_action(seen(), [np.nan] * 3).opening == 0.05


def test_a_teachers_command_equals_its_action():
    before = Command(0.05, 4.0, 0.01)
    after = command_from_action(replace(seen(), command=before), [-0.3, 0.25, 0.7])
    np.testing.assert_allclose(
        action_from_commands(before, after, PERIOD), [-0.3, 0.25, 0.7], atol=1e-12
    )


def test_the_goal_stays_within_reach_of_the_jaws():
    command = Command(0.02, 4.0)
    assert command_from_action(
        seen(opening=0.05, command=command), [-1, 0, 0]
    ).opening == pytest.approx(0.046)


def test_a_grasp_from_approach_to_done():
    """Phases change by touch, height and time: the only clock is the period, the only force the
    estimate."""
    command = Command(0.05, 4.0)
    phases = []
    course = (
        [((0, 0), 0.05, 0.0)] * 2
        + [((0.1, 0), 0.05, 0)] * 2
        + [((0.5, 0.5), 0.05, 0)] * 2
        + [((0.5, 0.5), 0.05, 0.01)] * 2
    )
    course += (
        [((0.5, 0.5), 0.05, 0.04)] * 64 + [((0.5, 0.5), 0.05, 0.0)] * 2 + [((0, 0), 0.06, 0.0)] * 2
    )
    for forces, opening, height in course:
        command = command_from_action(seen(forces, opening, height, command), [0, 0, 0])
        if not phases or phases[-1] != command.phase:
            phases.append(command.phase)
    assert phases == ["approach", "close", "regulate", "lift", "hold", "lower", "release", "done"]


def test_a_lost_object_is_not_held():
    command = Command(0.05, 4.0, 0.03, "hold", {"phase_time": 0.2, "grip_opening": 0.05})
    for _ in range(17):
        command = command_from_action(seen((0, 0), 0.05, 0.04, command), [0, 0, 0])
    assert command.phase == "lower"
    for height in (0.0, 0.0):
        command = command_from_action(seen((0, 0), 0.06, height, command), [0, 0, 0])
    assert command.phase == "abort"  # not "done": nothing was set down


@pytest.mark.parametrize(("rate", "phase"), [(1.0, "release"), (0.0, "lower")])
def test_an_opening_grip_is_a_release_where_the_table_comes_early(rate, phase):
    """The place is 20 mm above the table of the start, 5 mm higher than specified."""
    goal = TaskGoal(place_height=0.015)
    last = Command(0.05, 4.0, 0.02, "lower", {"grip_opening": 0.05})
    for _ in range(3):
        last = command_from_action(
            replace(seen((0.4, 0.4), 0.05, 0.02, last), goal=goal), (rate, 0.0, 0.0)
        )
    assert last.phase == phase


def test_lowering_continues_below_a_place_that_is_lower_than_specified():
    last = Command(0.05, 4.0, 0.01, "lower", {"grip_opening": 0.05})
    observation = replace(seen((0.4, 0.4), 0.05, 0.01, last), goal=TaskGoal(place_height=0.02))
    last = command_from_action(observation, (0.0, 0.0, -1.0))
    assert last.phase == "lower" and last.lift_height < 0.01


@pytest.mark.parametrize("handover", [False, True])
def test_an_opening_grip_hands_over(handover):
    """With `handover` the hold ends when the goal of the jaws is 1 mm beyond the grip."""
    goal = TaskGoal(handover=handover)
    last = Command(0.05, 4.0, 0.04, "hold", {"grip_opening": 0.05})
    phases = []
    for _ in range(3):  # by 1.7 mm in each cycle
        last = command_from_action(
            replace(seen((0.4, 0.4), 0.05, 0.04, last), goal=goal), (1.0, 0.0, 0.0)
        )
        phases.append(last.phase)
    assert phases == ["hold", *(2 * ["release" if handover else "hold"])]
