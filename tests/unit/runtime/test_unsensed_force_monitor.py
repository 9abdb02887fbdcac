"""Tests of the flag for servo force beyond the measured one; friction, a rough data sheet and short
pushes do not raise it."""

import math
from types import SimpleNamespace

import pytest

from mjtactile.runtime.unsensed_force_monitor import KIND, UnsensedForceMonitor

PERIOD = 1 / 30


def pushed(watch, effort, estimated, seconds=1.0):
    """Return the flags after a push of `seconds` with this servo effort and finger force."""
    touch = SimpleNamespace(force_normal=estimated, touching=estimated > 0.05)
    start = watch.time
    for k in range(1, round(seconds / PERIOD) + 1):
        gripper = SimpleNamespace(effort=effort)
        watch.time = start + k * PERIOD
        watch.add(SimpleNamespace(time=watch.time, touch=(touch, touch), gripper=gripper))
    return watch.flags


@pytest.fixture
def watch():
    monitor = UnsensedForceMonitor(("left", "right"), PERIOD)
    monitor.time = 0.0
    return monitor


@pytest.mark.parametrize(
    ("free", "effort", "estimated"),
    [
        (0.4, 0.9, 0.6),  # a grasp through gears
        (0.4, 2.6, 2.0),  # an error of 20 % of the data sheet, and the same gears
        (0.0, 0.7, 0.9),  # or off the other way
        (-0.4, -0.5, 0.0),  # jaws that open
        (0.4, math.nan, 0.6),  # no current
        (0.4, 5.0, math.nan),  # no force
    ],
)
def test_gear_friction_and_data_sheet_tolerances_raise_no_flag(watch, free, effort, estimated):
    assert not pushed(watch, free, 0.0)
    assert not pushed(watch, effort, estimated)


def test_a_frame_that_carries_ten_newtons_is_reported(watch):
    pushed(watch, 0.3, 0.0)
    assert not pushed(watch, 11.0, 1.0, 0.1)  # a jolt
    pushed(watch, 0.3, 0.0)
    flags = pushed(watch, 11.0, 1.0)
    assert set(flags) == {KIND}
    assert "push with 11.0 N, but left and right measure 1.0 N" in flags[KIND]
    assert "carry 10.0 N" in flags[KIND]
    found = pushed(watch, 0.3, 0.0)[KIND]
    assert "carry 10.0 N" in found  # the maximum stays
    # pushes of 1 s each after 2.1 s; the window of 0.3 s delays the flag, and the next one clears it
    assert found.first == pytest.approx(2.1 + 0.3, abs=0.07)
    assert found.last == pytest.approx(3.1, abs=0.07)


def test_an_unsensed_jaw_force_is_not_friction(watch):
    assert "measure 0.0 N" in pushed(watch, 4.0, 0.0, 3.0)[KIND]
