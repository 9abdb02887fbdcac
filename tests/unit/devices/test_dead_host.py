"""Tests of the gripper after its host has died, on servos with different watchdog actions (decision
19).

Two jaws on racks close on a spring between them; the host stops during the motion. The mechanism is
quasi-static: a jaw moves to its goal, or until the spring balances its torque.
"""

import contextlib
import logging
import math
import threading

import pytest

from mjtactile.core import scaled_clock
from mjtactile.core.types import Command
from tests.emulated import ANGLE, servo_bench, wait_for

pytestmark = pytest.mark.clock

RADIUS = 0.012  # radius of GRIPPER, m/rad
START = 2 * RADIUS * ANGLE  # opening of 72 mm, m
STIFFNESS = 400.0  # stiffness of the spring at each finger, N/m
FORCE = 2.0  # force limit of the host, N
SPEED = 3.0  # rad/s of the jaws
LEAD = 0.1 * 0.1  # lead in m: 0.1 s at GRIPPER's maximum speed
KINDS = {"brake": {}, "limp": {"trip": "limp"}, "goes on": {"firmware": 51}}


class Jaws:
    """Running mechanism; the spring is in contact below an opening of `touch` m. `silence` s are
    added to the watchdogs' clock."""

    def __init__(self, bench, touch):
        self.bench = bench
        self.touch = touch / 2
        self.silence = 0.0
        self._stop = scaled_clock.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self):
        self._stop.set()
        self._thread.join()

    @property
    def opening(self):
        return sum(RADIUS * servo.angle for servo in self.bench.servos.values())

    def forces(self):
        return [
            STIFFNESS * max(0.0, self.touch - RADIUS * servo.angle)
            for servo in self.bench.servos.values()
        ]

    def settled(self):
        """Wait until the motion has ended: a servo that continues needs 0.14 s for 10 mm."""

        def rests():
            before = self.opening
            scaled_clock.sleep(0.1)
            return self.opening == before

        assert wait_for(rests)

    def _run(self):
        last = scaled_clock.monotonic()
        while not self._stop.wait(0.004):
            now = scaled_clock.monotonic()
            for servo in self.bench.servos.values():
                servo.check_watchdog(now + self.silence)
                self._move_pressures(servo, min(now - last, 0.02))
            last = now

    def _move_pressures(self, servo, period):
        drive = servo.drive()
        # where spring and motor balance
        pressed = (self.touch - drive.torque_max / RADIUS / STIFFNESS) / RADIUS
        goal = (
            max(drive.goal, pressed) if drive.torque_max else max(servo.angle, self.touch / RADIUS)
        )
        step = min(max(goal - servo.angle, -SPEED * period), SPEED * period)
        torque = STIFFNESS * max(0.0, self.touch - RADIUS * servo.angle) * RADIUS
        servo.follow_load(servo.angle + step, step / max(period, 1e-6), -torque, period)


@contextlib.contextmanager
def gripper_rig(kind, touch):
    with servo_bench(**KINDS[kind]) as bench:
        jaws = Jaws(bench, touch)
        gripper = None
        try:
            gripper = bench.gripper()
            yield bench, jaws, gripper
        finally:
            if gripper is not None:
                gripper.close(quiet=True)
                gripper.bus.close()
            jaws.close()


def close_until(gripper, condition):
    """Command closed jaws at maximum speed."""
    deadline = scaled_clock.monotonic() + 20
    while not condition():
        assert scaled_clock.monotonic() < deadline
        gripper.state()
        gripper.command(Command(0.0, FORCE))
        scaled_clock.sleep(0.005)


def stop_host(bench, jaws, gripper):
    """Stop the host and wait until the watchdogs have tripped."""
    gripper._closed.set()  # without keep-alive requests and without a shutdown
    gripper._keeper.join()
    jaws.silence = 10.0
    assert wait_for(lambda: all(servo.tripped for servo in bench.servos.values()))
    jaws.settled()


@pytest.mark.parametrize("kind", KINDS)
def test_grip_force_does_not_increase_after_the_host_stops(kind):
    """After the host's death the grip force never exceeds the limit that the host had set.

    Braking or continuing, it is that limit (a unit of current, 0.03 N, less). With limp servos it
    is zero.
    """
    with gripper_rig(kind, touch=START - 0.008) as (bench, jaws, gripper):
        close_until(gripper, lambda: min(jaws.forces()) > 0.9 * FORCE)
        stop_host(bench, jaws, gripper)
        forces = jaws.forces()
        if kind == "limp":
            assert max(forces) == pytest.approx(0.0, abs=0.02)
        else:
            assert max(forces) <= FORCE + 0.01
            assert min(forces) > 0.8 * FORCE  # it is held


@pytest.mark.parametrize("kind", KINDS)
def test_a_moving_gripper_stops_without_its_host(kind):
    """A moving gripper stops within 10 mm of the last opening that the host received.

    The command was to close by 72 mm, and no object is between the jaws.
    """
    with gripper_rig(kind, touch=0.0) as (bench, jaws, gripper):
        close_until(gripper, lambda: jaws.opening < START - 0.015)
        known = gripper.geometry.opening(
            {servo: ticks for servo, (ticks, _) in gripper.positions.items()}
        )
        stop_host(bench, jaws, gripper)
        assert jaws.opening > known - LEAD - 2 * RADIUS * 2 * math.pi / 4096  # a tick of each
        if kind == "goes on":
            # that is where its goal was
            assert jaws.opening == pytest.approx(known - LEAD, abs=2 * RADIUS * 2 * math.pi / 4096)


def test_firmware_without_a_stop_is_reported(caplog):
    with caplog.at_level(logging.WARNING), gripper_rig("goes on", touch=0.0):
        pass
    assert [
        r.message
        for r in caplog.records
        if "firmware 51, whose bus watchdog does not stop it" in r.message
    ]
