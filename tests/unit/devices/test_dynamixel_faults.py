"""Tests of the gripper driver with faults of servos and bus and silent hosts: torque is off after
every exit."""

import contextlib
import math

import pytest

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Command
from mjtactile.devices.dynamixel.gripper import ServoFault
from tests.emulated import ANGLE, wait_for

pytestmark = pytest.mark.clock

TICK = 2 * math.pi / 4096


@pytest.mark.parametrize("fast", [False, True])
def test_a_hardware_error_is_reported_in_the_next_cycle(bench, fast):
    gripper = bench.gripper(fast_sync=fast)
    try:
        gripper.state()
        bench.servos[2].raise_error(0x20)
        with pytest.raises(ServoFault, match=r"servo 2 .* overload"):
            gripper.state()
    finally:
        gripper.close()


def test_a_state_has_the_time_of_its_request(bench):
    """A state has the time of its request, and later motion is not in it.

    The servos answer while the loop processes its image.
    """
    gripper = bench.gripper()
    try:
        before = gripper.state()
        gripper.request_state()
        requested = scaled_clock.monotonic()
        wait_for(lambda: gripper.bus._port.ser.in_waiting >= 2 * 32)  # both have answered
        bench.servos[2].follow_load(ANGLE + 0.5, 0.0, 0.0, 0.01)
        state = gripper.state()
        assert state.opening == before.opening and before.time < state.time <= requested
        # of the 6 mm that the jaw has moved
        assert gripper.state().opening > before.opening + 0.005
    finally:
        gripper.close()


def test_a_reply_between_request_and_state_corrupts_neither(bench):
    gripper = bench.gripper(reply_timeout=0.05)
    try:
        before = gripper.state()
        gripper.request_state()
        gripper.command(Command(before.opening, 1.0))
        bench.servos[2].follow_load(ANGLE + 0.5, 0.0, 0.0, 0.01)
        for _ in range(2):  # the answers were discarded, and the servos are read again
            assert gripper.state().opening > before.opening + 0.005
    finally:
        gripper.close()


def test_two_lost_replies_are_tolerated_and_two_cycles_are_not(bench):
    gripper = bench.gripper(reply_timeout=0.05)
    gripper._closed.set()  # ends the keep-alive thread, so that this test counts the readings
    gripper._keeper.join()
    gripper._closed.clear()
    try:
        before = gripper.state()
        bench.faults.set("servo_silent", 2)
        blind = gripper.state()  # requested twice
        # the state carries its age
        assert blind.opening == before.opening and blind.time == before.time
        with pytest.raises(DeviceError, match=r"servo 2 .* no reply 3 times"):
            gripper.state()
    finally:
        bench.faults.set("servo_silent", 0)
        gripper.close()


def drop_next_reply(bench, servo):
    """Drop the next reply of that servo; return a list that has an entry when the reply was due."""
    reply = bench.bus._status
    dropped = []

    def once_lost(status, *rest):
        if status.id == servo and not dropped:
            dropped.append(1)
            return b""
        return reply(status, *rest)

    bench.bus._status = once_lost
    return dropped


def test_the_first_reply_on_a_new_port_may_be_lost(bench):
    """Adapters lose a packet when they are opened, and a busy computer is late."""
    dropped = drop_next_reply(bench, 1)
    bench.gripper(reply_timeout=0.05).close()
    assert dropped


def test_a_damaged_reply_is_requested_again_in_the_same_cycle(bench):
    gripper = bench.gripper(reply_timeout=0.05)
    try:
        before = gripper.state()
        bench.servos[2].follow_load(ANGLE + 0.5, 0.0, 0.0, 0.01)
        dropped = drop_next_reply(bench, 2)
        after = gripper.state()
        assert dropped
        assert after.opening - before.opening == pytest.approx(0.012 * 0.5, abs=2 * 0.012 * TICK)
    finally:
        gripper.close()


def test_a_brown_out_is_detected(bench):
    gripper = bench.gripper()
    try:
        bench.servos[1].brown_out()
        with pytest.raises(ServoFault, match="restart"):
            for _ in range(2):  # each of two servos is read in every second reading
                gripper.state()
    finally:
        gripper.close()


def test_a_silent_host_trips_the_watchdog_and_the_driver_reports_it(bench):
    gripper = bench.gripper()
    try:
        gripper.command(Command(0.07, 2.0))
        bench.servos[1].check_watchdog(scaled_clock.monotonic() + 10)
        assert bench.servos[1].drive().goal == pytest.approx(ANGLE, abs=TICK)  # held where it is
        with pytest.raises(ServoFault, match="bus watchdog"):
            for _ in range(12):
                gripper.state()
        gripper.command(Command(0.08, 2.0))  # a late host can still retreat
        goal = round(0.08 / 2 / 0.012 / TICK)
        assert wait_for(lambda: bench.servos[1].get("Goal Position") == goal)
        assert bench.servos[1].get("Bus Watchdog") == 100  # and is watched again
        # a cleared watchdog is raised once: the opening that verifies the retreat is measured again
        assert 0.0 < gripper.state().opening < 0.12
    finally:
        gripper.close()


def test_a_host_that_vanished_is_silence_for_the_watchdog(bench):
    """A closed pty is reported as readable; for the emulated watchdog this is not traffic."""
    gripper = bench.gripper()
    gripper.close()
    assert wait_for(lambda: not bench.bus.is_busy())


def test_keep_alive_stops_when_the_host_is_silent(bench):
    """The watchdog must be able to trip: 0.25 s after the last call of a running loop no packet is
    sent."""
    gripper = bench.gripper(watchdog=0.1)
    try:
        gripper.command(Command(0.07, 2.0))
        assert wait_for(lambda: scaled_clock.monotonic() - bench.servos[1].last_packet > 0.5)
    finally:
        gripper.close()


# -- ending
# --------------------------------------------------------------------------------


def test_torque_is_off_after_close(bench):
    with contextlib.closing(bench.gripper()) as gripper:
        gripper.command(Command(0.05, 2.0))
    assert [servo.get("Torque Enable") for servo in bench.servos.values()] == [0, 0]


def test_torque_of_all_motors_is_disabled_when_one_fails(bench):
    gripper = bench.gripper(reply_timeout=0.05)
    bench.faults.set("servo_silent", 1)
    with pytest.raises(DeviceError, match=r"torque of servo 1 .* could not be switched off"):
        gripper.close()
    assert bench.servos[2].get("Torque Enable") == 0
    gripper.close()  # a second call has no effect


def test_torque_is_off_after_a_failed_connection(bench):
    bench.servos[2].angle = 20.0  # out of the gripper's range
    bench.servos[2]._lost_turns = 0.0
    bench.servos[2].follow_load(20.0, 0.0, 0.0, 0.01)
    with pytest.raises(DeviceError, match=r"stands at .* ticks"):
        bench.gripper()
    assert bench.servos[1].get("Torque Enable") == 0


def test_an_unplugged_bus_is_an_error_and_closing_still_returns(bench):
    gripper = bench.gripper()
    bench.bus.close()
    with pytest.raises(DeviceError, match="is lost"):
        gripper.state()
    with pytest.raises(DeviceError, match="could not be switched off"):
        gripper.close()
