"""Tests that the probe controller ends for any touch signal."""

import pytest

from mjtactile.core.types import Command, GripperState, Observation, Touch
from mjtactile.runtime.controller import load_controller

PERIOD = 1 / 30
probe = load_controller("probe")
MEMORY = {"presses": 1.0, "touch_opening": 0.04}


def opened(estimated, seconds=20.0):
    """Return the command after `seconds`, or at the end, with the force `estimated` on both fingers."""
    command = Command(0.038, 4.0, 0.0, "release", MEMORY)
    touch = Touch(0.0, 0.01, estimated, 0.01, estimated > 0.05)
    for k in range(round(seconds / PERIOD)):
        state = GripperState(command.opening, 0.0, 0.0, 0.0)
        command = probe.step(Observation(k * PERIOD, PERIOD, (touch, touch), state, (), command))
        if command.phase != "release":
            return command, k * PERIOD
    return command, seconds


def test_a_finger_without_release_ends_the_probe_with_a_reason():
    """A constant force of 0.1 N with open jaws ends the probe with that reason.

    An uncalibrated sensor five times as stiff as in its file estimates 0.1 N without contact.
    """
    command, after = opened(0.1)
    assert command.phase == "abort" and "a finger measures 0.10 N with open jaws" in command.reason
    opening = (0.04 + 0.003 - 0.038) / 0.015  # opening time, s
    assert opening < after == pytest.approx(4.0, abs=2 * PERIOD)


def test_a_release_is_checked_again():
    command, _ = opened(0.0)
    assert command.phase == "approach" and command.reason == ""
