"""Tests of an emulated servo's motion and bus watchdog against the e-manual of XL330 and XM430.

The test turns the shaft explicitly (`turn`), so that the computer's speed has no influence.
"""

import math

import pytest

from mjtactile.core import scaled_clock
from mjtactile.emulator.servo import EmulatedServo
from tests.emulated import ANGLE
from tests.sdk_client import OK, sdk_client, turn

TICKS = round(ANGLE / (2 * math.pi) * 4096)
RPM = 0.229 * 2 * math.pi / 60  # rad/s of a velocity unit


@pytest.fixture
def xl():
    with sdk_client() as client:
        yield client


# -- motion
# --------------------------------------------------------------------------------


def on(one, mode, **registers):
    assert one.write("Operating Mode", mode) == 0
    for name, value in registers.items():
        assert one.write(name.replace("_", " "), value) == 0
    assert one.write("Torque Enable", 1) == 0


@pytest.mark.clock
@pytest.mark.parametrize(
    ("mode", "goal", "value"),
    [(0, "Goal Current", -100), (1, "Goal Velocity", -50), (16, "Goal PWM", -200)],
)
def test_modes_without_a_position_move(xl, mode, goal, value):
    on(xl, mode)
    assert xl.write(goal, value) == 0
    turn(xl.bench.servos[1], 0.5)
    assert xl.bench.servos[1].angle < ANGLE - 0.4
    if mode == 1:
        # a tick
        assert xl.bench.servos[1].angle == pytest.approx(
            ANGLE - 0.5 * 50 * RPM, abs=50 * RPM * 0.011
        )
        assert xl.read("Present Velocity") == (1 << 32) - 50
    assert xl.read("Moving") == 1


@pytest.mark.clock
def test_a_profile_has_its_duration_and_reports_it(xl):
    on(xl, 4)
    assert xl.write("Profile Velocity", 20) == 0  # 0.48 rad/s
    assert xl.write("Goal Position", TICKS + 1000) == 0  # 1.534 rad: 3.2 s
    turn(xl.bench.servos[1], 1.0)
    # a tick behind its path
    assert xl.bench.servos[1].angle == pytest.approx(ANGLE + 20 * RPM, abs=20 * RPM * 0.011)
    assert (xl.read("Moving"), xl.read("Velocity Trajectory"), xl.read("Moving Status")) == (
        1,
        20,
        0x12,
    )
    assert xl.read("Position Trajectory") == pytest.approx(
        TICKS + 20 * RPM * 4096 / (2 * math.pi), abs=1
    )
    turn(xl.bench.servos[1], 3.0)
    assert xl.read("Present Position") == TICKS + 1000
    assert (xl.read("Moving"), xl.read("Velocity Trajectory"), xl.read("Moving Status")) == (
        0,
        0,
        0x11,
    )


def test_a_trapezoid_reaches_its_goal_without_overshoot():
    servo = EmulatedServo(1, "XL330-M288")
    for address, size, value in ((11, 1, 4), (64, 1, 1), (108, 4, 5), (112, 4, 50), (116, 4, 800)):
        assert servo.write(address, value.to_bytes(size, "little")) == 0
    speeds = []
    for _ in range(300):
        servo.turn(0.01)
        speeds.append(servo.speed)
        assert servo.angle <= 800 * 2 * math.pi / 4096 + 1e-9
    assert servo.angle == pytest.approx(800 * 2 * math.pi / 4096)
    assert max(speeds) == pytest.approx(50 * RPM, rel=1e-6)
    assert (
        max(b - a for a, b in zip(speeds, speeds[1:], strict=False))
        <= 5 * 214.577 * 2 * math.pi / 3600 * 0.01 + 1e-9
    )


@pytest.mark.clock
def test_homing_offset_is_added_to_the_position(xl):
    """The homing offset, as lerobot's calibration writes it, is added to the position."""
    assert xl.write("Homing Offset", 500) == 0
    assert xl.read("Present Position") == TICKS + 500
    on(xl, 4)
    assert xl.write("Goal Position", TICKS + 600) == 0
    turn(xl.bench.servos[1], 1.0)
    assert xl.bench.servos[1].angle == pytest.approx(
        ANGLE + 100 * 2 * math.pi / 4096, abs=2 * math.pi / 4096
    )
    assert xl.write("Torque Enable", 0) == 0
    assert xl.write("Homing Offset", 2000) == 0
    assert xl.write("Operating Mode", 3) == 0
    assert xl.read("Present Position") == TICKS + 100  # beyond 1024 it is ignored in mode 3


@pytest.mark.clock
def test_clear_resets_full_turns_of_a_shaft_at_rest(xl):
    servo = xl.bench.servos[1]
    on(xl, 4)
    assert xl.write("Goal Position", TICKS + 8192) == 0
    servo.turn(0.01)
    assert xl.packets.clearMultiTurn(xl.port, 1) == (OK, 1)  # it moves
    turn(servo, 4.0)
    assert xl.packets.clearMultiTurn(xl.port, 1) == (OK, 0)
    assert xl.read("Present Position") == TICKS


# -- the bus watchdog
# --------------------------------------------------------------------------------


def tripped(mode=5, **how):
    """Return a moving servo whose host was lost: from 1 rad to 2 rad, or with 0.1 A or 1 rad/s."""
    servo = EmulatedServo(1, "XL330-M288", angle=1.0, **how)
    goal = {0: (102, 2, 100), 1: (104, 4, 42), 16: (100, 2, 200)}.get(mode, (116, 4, 1304))
    for address, size, value in ((11, 1, mode), (98, 1, 5), (64, 1, 1), goal):
        assert servo.write(address, value.to_bytes(size, "little")) == 0
    turn(servo, 0.05)
    servo.check_watchdog(scaled_clock.monotonic() + 1)
    return servo, servo.angle


@pytest.mark.clock
@pytest.mark.parametrize("mode", [0, 1, 3, 4, 5, 16])
def test_a_trip_stops_the_servo_and_makes_its_goals_read_only(mode):
    servo, at = tripped(mode)
    turn(servo, 0.5)
    assert servo.angle == pytest.approx(at, abs=2 * math.pi / 4096)
    assert servo.get("Bus Watchdog") == 0xFF
    assert (servo.drive().torque_max > 0) == (mode not in (0, 16))  # held where it is, or free
    assert servo.write(116, (1).to_bytes(4, "little")) == 4
    assert servo.write(98, b"\0") == 0
    assert servo.write(116, (1000).to_bytes(4, "little")) == 0


@pytest.mark.clock
def test_a_limp_servo_has_no_torque():
    assert tripped(trip="limp")[0].drive().torque_max == 0


@pytest.mark.clock
def test_firmware_51_of_a_330_reports_the_trip_and_continues():
    servo, at = tripped(firmware=51)
    turn(servo, 0.5)
    assert servo.get("Bus Watchdog") == 0xFF
    assert servo.angle == pytest.approx(1304 * 2 * math.pi / 4096) and servo.angle > at + 0.5
    assert EmulatedServo(1, "XM430-W350", firmware=51)._ignores_watchdog is False


@pytest.mark.clock
def test_with_a_homing_offset_a_trip_moves_the_motor():
    servo = EmulatedServo(1, "XL330-M288", angle=1.0)
    for address, size, value in ((20, 4, 300), (11, 1, 4), (98, 1, 5), (64, 1, 1)):
        assert servo.write(address, value.to_bytes(size, "little")) == 0
    for i in range(100):
        servo.check_watchdog(scaled_clock.monotonic() + 1 + i)
        servo.turn(0.01)
    assert servo.angle < -1.0  # and on


@pytest.mark.clock
def test_without_torque_the_watchdog_does_not_trip():
    servo = EmulatedServo(1, "XL330-M288")
    assert servo.write(98, b"\x05") == 0
    servo.check_watchdog(scaled_clock.monotonic() + 10)
    assert servo.get("Bus Watchdog") == 5
