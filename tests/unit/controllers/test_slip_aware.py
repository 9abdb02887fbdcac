"""The slip-aware controller grips harder at a slip of either finger, within its limit, and waits
with the lift meanwhile."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.types import (
    Command,
    GripperState,
    Observation,
    Slip,
    SlipState,
    Touch,
    ValveState,
)
from mjtactile.runtime.controller import load_controller

PERIOD = 1 / 30
controller = load_controller("slip_aware")
FIRST, STRONGEST = (controller.function.__globals__[name] for name in ("FIRST_FORCE", "FORCE_MAX"))


def touch(force, state: SlipState = "sticking"):
    return Touch(0.0, 0.01, force, 0.01, force > 0.08, slip=Slip(state, np.zeros(2), 0.0, 0.5))


def run(command, estimated, count=1):
    """Run `count` cycles with the touches `estimated`, on a gripper that reaches every goal
    immediately."""
    for i in range(count):
        state = GripperState(command.opening, 0.0, 0.6, command.lift_height)
        command = controller.step(
            Observation(i * PERIOD, PERIOD, estimated, state, (ValveState(False),) * 2, command)
        )
    return command


HELD = Command(0.04, 4.0, 0.02, "lift")


def test_a_slip_of_a_finger_raises_the_force_and_stops_the_lift():
    calm = run(HELD, (touch(FIRST), touch(FIRST)))
    assert (
        calm.memory["target"] == FIRST
        and calm.opening == pytest.approx(HELD.opening)
        and calm.lift_height > 0.02
    )
    slips = run(HELD, (touch(FIRST), touch(FIRST, "slipping")))
    assert slips.memory["target"] > 1.3 * FIRST and slips.opening < HELD.opening - 0.9e-3
    assert slips.lift_height == HELD.lift_height


def test_grip_force_is_at_most_its_limit():
    estimated = (touch(1.5, "slipping"), touch(1.5, "slipping"))
    assert run(HELD, estimated, 60).memory["target"] == STRONGEST


def test_before_a_slip_the_grip_increases_in_small_steps_while_the_gripper_follows():
    near = run(HELD, (touch(FIRST, "incipient"),) * 2)
    assert FIRST < near.memory["target"] < FIRST + 0.05
    # the requested force has not been reached yet
    assert run(HELD, (touch(0.1, "incipient"),) * 2).memory["target"] == FIRST


def test_unknown_estimates_are_not_used():
    unknown = replace(touch(FIRST), slip=None)
    assert run(HELD, (unknown, unknown)).memory["target"] == FIRST
    blind = (touch(math.nan), touch(FIRST))
    assert run(HELD, blind).opening == HELD.opening and run(HELD, blind, 20).phase == "abort"


def test_an_object_left_behind_is_released():
    assert run(HELD, (touch(0.0), touch(0.01)), 12).phase == "release"
