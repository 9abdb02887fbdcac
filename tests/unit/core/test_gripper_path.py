"""Tests of `GripperPath`: positions, times and accelerations of a minimum-jerk motion."""

import math

import numpy as np
import pytest

from mjtactile.core.gripper_path import GripperPath, Segment


def segment(x=None, y=None, z=None, tilt=None, speed=0.2, tilt_speed=1.0, wait=0.0):
    return Segment(x, y, z, tilt, speed, tilt_speed, wait)


def test_a_path_stops_at_each_waypoint_and_keeps_missing_coordinates():
    path = GripperPath.of([segment(y=0.2, wait=0.5), segment(x=-0.1, tilt=0.3, wait=0.1)])
    # 0.2 m at 0.2 m/s; then 0.1 m, which takes longer than 0.3 rad at 1 rad/s
    assert path.starts == pytest.approx((0.5, 1.6)) and path.ends == pytest.approx((1.5, 2.1))
    np.testing.assert_allclose(path.at(0.4), 0)
    np.testing.assert_allclose(path.at(1.0), [0, 0.1, 0, 0])  # half-way by symmetry
    np.testing.assert_allclose(path.at(1.55), [0, 0.2, 0, 0])
    np.testing.assert_allclose(path.at(9.0), [-0.1, 0.2, 0, 0.3])
    assert path.end == pytest.approx(2.1) and path.max_offset == pytest.approx(0.2)
    assert [path.next_start(time) for time in (0.0, 0.9, 1.55, 3.0)] == pytest.approx(
        [0.5, 0.5, 1.6, math.inf]
    )


def test_the_acceleration_is_the_second_derivative_of_the_position():
    path = GripperPath.of([segment(y=0.2, wait=0.5), segment(x=-0.1)])
    step = 1e-4
    for time in (0.2, 0.6, 0.9, 1.3, 1.6, 1.9):
        around = [path.at(time + offset)[:3] for offset in (-step, 0.0, step)]
        second = (around[0] - 2 * around[1] + around[2]) / step**2
        np.testing.assert_allclose(path.acceleration(time), second, atol=1e-4)


def test_the_largest_load_contains_gravity_and_the_largest_acceleration():
    """The maximum of a minimum-jerk motion is 10 / sqrt(3) d / T^2; sampled, 0.5 % less."""
    path = GripperPath.of([segment(y=0.2, speed=1 / 3)])
    expected = math.hypot(9.81, 10 / math.sqrt(3) * 0.2 / 0.6**2)
    assert path.max_load(9.81) == pytest.approx(expected, rel=2e-3)
