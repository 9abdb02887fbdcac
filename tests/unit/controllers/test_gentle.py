"""The gentle controller notices that the object stays behind, opens where it is, and does not claim
to have held it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.types import (
    Command,
    GripperState,
    Observation,
    Slip,
    Touch,
    Traction,
    ValveState,
)
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.runtime.controller import load_controller

PERIOD = 1 / 30
step = load_controller("gentle").step


def touch(force, slipped=0.0):
    return Touch(
        0.0, 0.01, force, 0.01, force > 0.08, slip=Slip("slipping", np.zeros(2), slipped, 0.0)
    )


def heavy(fx, fy):
    """Return a finger that presses with 0.6 N and carries a load."""
    wrench = np.array([fx, fy, -0.6, 0.0, 0.0, 0.0])
    grid = np.linspace(-0.01, 0.01, 3)
    traction = Traction(grid, grid, np.zeros((3, 3, 3)), wrench, np.eye(6) * 1e-6, 1e3, "made up")
    return replace(touch(0.6), traction=traction)


def run(command, estimated, count):
    """Run `count` cycles with the touches `estimated`, on a gripper that reaches every goal
    immediately."""
    for i in range(count):
        state = GripperState(command.opening, 0.0, 0.6, command.lift_height)
        command = step(
            Observation(i * PERIOD, PERIOD, estimated, state, (ValveState(False),) * 2, command)
        )
    return command


@pytest.mark.parametrize("phase", ["lift", "hold", "lower"])
@pytest.mark.parametrize(
    "estimated",
    [(touch(0.0), touch(0.02)), (touch(0.6, 0.008), touch(0.6, 0.009))],
    ids=["nothing is felt", "it slid"],
)
def test_an_object_left_behind_is_released_at_the_grippers_position(phase, estimated):
    start = Command(0.04, 4.0, 0.02, phase)
    command = run(start, estimated, 12)  # 0.4 s
    assert command.phase == "release" and abs(command.lift_height - start.lift_height) < 0.02
    command = run(command, (touch(0.0),) * 2, 60)
    assert command.phase == "abort"  # and not "done", which means held
    assert command.opening == pytest.approx(0.04 + 0.012, abs=0.005)


def test_a_held_object_is_kept():
    for phase, force in (("lift", 0.6), ("hold", 0.3)):
        assert run(
            Command(0.04, 4.0, 0.02, phase), (touch(force, 4e-4), touch(force, 0.02)), 12
        ).phase in ("lift", "hold")


def test_jaws_blocked_by_an_unsensed_object_stop():
    """A fallen strawberry between the frames blocks the jaws; the approach ends before the time
    limit."""
    command = Command(0.08, 4.0, 0.0, "approach")
    empty = (touch(0.0),) * 2
    for i in range(120):  # 4 s at 25 mm/s would be 100 mm
        state = GripperState(max(command.opening, 0.0354), 0.0, 4.0, 0.0)
        command = step(
            Observation(i * PERIOD, PERIOD, empty, state, (ValveState(False),) * 2, command)
        )
        if command.phase == "abort":
            break
    assert command.phase == "abort" and command.opening == pytest.approx(0.0354)
    # jaws that follow continue
    assert run(Command(0.08, 4.0, 0.0, "approach"), empty, 60).phase == "approach"


@pytest.mark.parametrize("controller", ["gentle", "slip_aware", "touchless", "adaptive"])
@pytest.mark.parametrize("minimum", [0.0, 0.022])
def test_jaws_at_their_end_stop_hold_no_object(controller, minimum):
    """The three-fingered gripper closes to 22 mm; the approach ends there before the time limit."""
    its_step = load_controller(controller).step
    limits = CommandLimits(opening=(minimum, 0.1), speed=0.1, force=5.0, lift=(0.0, 0.1))
    command = Command(0.03, 0.0)
    for i in range(300):
        state = GripperState(command.opening, 0.0, 0.0, 0.0)
        estimated = () if controller == "touchless" else (touch(0.0),) * 2
        requested = its_step(Observation(i * PERIOD, PERIOD, estimated, state, (), command))
        command = limits.apply(requested, command, PERIOD)
        if command.phase == "abort":
            break
    assert command.phase == "abort" and command.reason == "the jaws closed without contact"
    # 30 mm at 10 to 25 mm/s, and 0.3 s at the stop
    assert command.opening == minimum and i * PERIOD < (0.03 - minimum) / 0.01 + 1.0


@pytest.mark.parametrize("controller", ["gentle", "slip_aware"])
@pytest.mark.parametrize(("up", "stops"), [(-0.3, False), (0.0, False), (0.3, True)])
def test_an_upward_force_while_lowering_is_the_table(controller, up, stops):
    """An upward push on the way down is taken as the table, and the gripper opens there.

    An object that slid 20 mm down stands on the table while the gripper is still up. Earlier
    versions pushed the gripper on over its edge. Shears are along x of one finger and y of the
    other: no input gives the downward direction.
    """
    its_step = load_controller(controller).step
    command = Command(0.04, 4.0, 0.04, "hold", {"phase_time": 1.9, "target": 0.6})
    phases = []
    for i in range(30):
        shear = -0.3 if command.phase == "hold" or command.lift_height > 0.02 else up
        estimated = (heavy(shear, 0.0), heavy(0.0, shear))
        state = GripperState(command.opening, 0.0, 0.6, command.lift_height)
        command = its_step(Observation(i * PERIOD, PERIOD, estimated, state, (), command))
        phases.append(command.phase)
    assert "lower" in phases and ("release" in phases) == stops
    assert not stops or command.lift_height > 0.015


def test_a_short_loss_of_contact_or_image_is_not_a_lost_object():
    command = run(Command(0.04, 4.0, 0.02, "hold"), (touch(0.0),) * 2, 6)
    assert command.phase == "hold"
    assert run(command, (touch(0.6),) * 2, 6).memory["lost_time"] == 0.0
    blind = replace(touch(0.6), force_normal=math.nan)
    assert run(command, (blind, touch(0.0)), 6).phase == "hold"


@pytest.mark.parametrize("controller", ["gentle", "slip_aware", "touchless"])
def test_an_object_that_reaches_the_table_early_is_released(controller):
    """A strawberry tilted in the grip stops the gripper 3 mm above its goal; it is released and not
    pressed down."""
    its_step = load_controller(controller).step
    command = Command(0.04, 4.0, 0.04, "lower")
    held = (touch(0.6),) * 2
    for i in range(150):  # 5 s; coming down takes 1.0 to 1.6
        state = GripperState(command.opening, 0.0, 0.6, max(command.lift_height, 0.003))
        command = its_step(
            Observation(i * PERIOD, PERIOD, held, state, (ValveState(False),) * 2, command)
        )
        if command.phase != "lower":
            break
    assert command.phase == "release" and 1.0 < i * PERIOD < 3.0
