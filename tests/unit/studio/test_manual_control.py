"""Tests of manual control in place of the controller."""

import math
from pathlib import Path
from types import SimpleNamespace

import pytest

from mjtactile.core.types import Command, GripperState, Observation, Touch
from mjtactile.studio.manual_control import ManualControl, ManualGoal

PERIOD = 1 / 30


def observe(command, force=0.0, opening=None):
    touch = Touch(0.0, 0.0, force, 0.01, force > 0.05)
    state = GripperState(
        command.opening if opening is None else opening, 0.0, 0.0, command.lift_height
    )
    return Observation(0.0, PERIOD, (touch, touch), state, (), command)


def run(manual_goal, command, cycles, squeeze=lambda opening: 0.0):
    for _ in range(cycles):
        command = manual_goal.command(observe(command, squeeze(command.opening)))
    return command


def test_manual_motion_has_the_speed_of_the_gripper_and_keeps_the_controller_memory():
    start = Command(0.06, 0.0, 0.0, "lift", {"settled_time": 0.3})
    one = ManualGoal(0.05, 0.02).command(observe(start))
    assert one.opening == pytest.approx(0.06 - 0.03 * PERIOD) and one.lift_height == pytest.approx(
        0.04 * PERIOD
    )
    assert one.phase == "lift" and one.memory == start.memory
    end = run(ManualGoal(0.05, 0.02), start, 60)
    assert (end.opening, end.lift_height) == (0.05, 0.02)


def test_manual_grip_has_the_requested_force():
    """The gripper squeezes with the requested force.

    A spring of 160 N/m on each finger acts below 50 mm: 0.6 N is measured at 50 mm - 2 x 3.75
    mm.
    """
    end = run(
        ManualGoal(math.nan, 0.0, 0.6),
        Command(0.06, 4.0),
        600,
        lambda opening: max(0.0, 160 * (0.05 - opening) / 2),
    )
    assert end.opening == pytest.approx(0.05 - 2 * 0.6 / 160, abs=1e-5)


def test_an_unknown_force_stops_manual_motion():
    command = Command(0.05, 4.0)
    assert ManualGoal(0.0, 0.0, 0.6).command(observe(command, math.nan)).opening == 0.05


def test_without_a_manual_request_the_controller_acts():
    manual = ManualControl(
        SimpleNamespace(path=Path("mine.py"), step=lambda observation: Command(0.01, 1.0))
    )
    observed = observe(Command(0.05, 4.0))
    assert manual.path == Path("mine.py") and manual.step(observed).opening == 0.01
    manual.manual_goal = ManualGoal(0.05, 0.0)
    assert manual.step(observed).opening == 0.05
    manual.manual_goal = None
    assert manual.step(observed).opening == 0.01
