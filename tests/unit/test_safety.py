"""The supervisor's state machine, and the control loop around it, on a rig of stubs."""

import math
from types import SimpleNamespace

import pytest

from mjtactile import control
from mjtactile.design import load_sensor
from mjtactile.errors import ControllerError, DeviceError
from mjtactile.rig import Limits, Rig
from mjtactile.safety import BLIND_TIME_MAX, RETREAT_OPENING, Supervisor
from mjtactile.types import Command, GripperState, Image, Touch, ValveState

PERIOD = 0.05
OK = Touch(0.0, 0.0, 0.5, 0.01, True)
BLIND = Touch(0.0, 0.0, math.nan, math.nan, False, status="too dark")
SEALED = ValveState(False, 1000.0)
LAST = Command(0.05, 4.0, 0.02, "hold")


@pytest.fixture
def supervisor():
    supervisor = Supervisor(PERIOD)
    supervisor.arm(0.0)
    return supervisor


def test_known_forces_let_the_controller_through(supervisor):
    wanted = Command(0.04, 4.0, 0.03, "hold")
    assert supervisor.decide(0.1, wanted, LAST, (OK, OK), (SEALED, SEALED)) is wanted
    assert supervisor.state == "running"


def test_unknown_force_neither_closes_nor_lifts(supervisor):
    sent = supervisor.decide(0.1, Command(0.04, 4.0, 0.03, "hold"), LAST, (OK, BLIND), (SEALED, SEALED))
    assert (supervisor.state, supervisor.reason) == ("holding", "too dark")
    assert (sent.opening, sent.lift_height) == (LAST.opening, LAST.lift_height)
    opened = supervisor.decide(0.15, Command(0.06, 4.0, 0.01, "hold"), LAST, (BLIND, BLIND), (SEALED, SEALED))
    assert (opened.opening, opened.lift_height) == (0.06, 0.01)  # away from harm is let through
    supervisor.decide(0.2, LAST, LAST, (OK, OK), (SEALED, SEALED))
    assert supervisor.state == "running"


def test_blind_for_long_goes_down_then_opens_then_latches(supervisor):
    last, states, heights = LAST, [], []
    for step in range(80):
        last = supervisor.decide(step * PERIOD, Command(0.03, 4.0, 0.05, "hold"), last, (BLIND, BLIND), (SEALED, SEALED))
        states.append(supervisor.state)
        heights.append((last.lift_height, last.opening))
    assert states.index("safe") == math.floor(BLIND_TIME_MAX / PERIOD) + 1
    assert states[-1] == "latched"
    opened_at = next(i for i, (_, opening) in enumerate(heights) if opening > LAST.opening)
    assert heights[opened_at - 1][0] < 1e-3  # first down
    assert last.opening == pytest.approx(LAST.opening + RETREAT_OPENING, abs=2e-4)
    assert "no force for 0.5 s: too dark" in supervisor.reason


def test_it_never_comes_back_from_safe(supervisor):
    supervisor.make_safe("overload", 0.0, LAST)
    supervisor.decide(0.1, Command(0.03, 4.0), LAST, (OK, OK), (SEALED, SEALED))
    assert supervisor.state == "safe"


@pytest.mark.parametrize("pressures", [(500.0, 1000.0), (1000.0, 600.0)])
def test_a_leak_is_found_by_pressure(supervisor, pressures):
    supervisor.decide(0.0, LAST, LAST, (OK, OK), (SEALED, SEALED))
    supervisor.decide(0.1, LAST, LAST, (OK, OK), tuple(ValveState(False, p) for p in pressures))
    assert supervisor.state == "safe"
    assert "lost pressure" in supervisor.reason


def test_a_leak_is_found_by_shape_without_a_sensor(supervisor):
    def seen(volume):
        return Touch(0.0, 0.0, 0.0, 0.01, False, surface=SimpleNamespace(volume=volume))  # type: ignore[arg-type]

    unknown = ValveState(False)
    supervisor.decide(0.0, LAST, LAST, (seen(1e-6), seen(1e-6)), (unknown, unknown))
    for step in range(3):
        supervisor.decide(0.1 + step * PERIOD, LAST, LAST, (seen(4e-7), seen(1e-6)), (unknown, unknown))
    assert supervisor.state == "safe"
    assert "has sunk" in supervisor.reason


# -- the loop ------------------------------------------------------------------------------------------------------------

class World:
    """A rig of stubs whose parts can be told to fail."""

    def __init__(self):
        self.time, self.broken, self.sent = 0.0, "", []
        self.opening, self.lift = 0.05, 0.02

    def now(self):
        return self.time

    def start(self, time):
        pass

    def wait_until(self, time):
        self.time = max(self.time, time)

    def read(self):
        if self.broken == "camera":
            raise DeviceError("left camera is stale")
        import numpy as np

        return Image(np.zeros((2, 2), np.uint8), self.time)

    def ask(self):
        pass

    def state(self):
        if self.broken in ("gripper", "all"):
            raise DeviceError("servo 1 reports overload")
        return GripperState(self.opening, 0.0, 0.5, self.lift)

    def command(self, command):
        if self.broken == "all":
            raise DeviceError("servo port is lost")
        self.opening, self.lift = command.opening, command.lift_height
        self.sent.append(command)
        return command

    def rig(self):
        return Rig("stub", load_sensor("paper16"), (self,), (), self, self, Limits(), close=lambda: None)

    def run(self, broken, after=5, controller=lambda o: o.command, time_limit=30.0, error=DeviceError):
        cycles = []

        def on_cycle(cycle):
            cycles.append(cycle)
            if len(cycles) == after:
                self.broken = broken

        pipeline = SimpleNamespace(perceive=lambda image, now: OK)
        with pytest.raises(error) as caught:
            control.run(self.rig(), [pipeline], SimpleNamespace(path="test", step=controller),  # type: ignore[list-item, arg-type]
                        time_limit=time_limit, on_cycle=on_cycle)
        return cycles, str(caught.value)


def test_a_stale_camera_holds_then_opens_and_the_run_ends():
    world = World()
    cycles, message = world.run("camera")
    assert message.startswith("stopped safely: no force for 0.5 s: left camera is stale")
    assert [c.state for c in cycles[5:7]] == ["holding", "holding"]
    assert math.isnan(cycles[5].touch[0].force_normal)  # unknown, neither zero nor the last one
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_faulty_servo_ends_in_the_safe_state_with_its_reason():
    world = World()
    _, message = world.run("gripper")
    assert message == "stopped safely: servo 1 reports overload"
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_when_nothing_obeys_the_run_ends_at_once():
    world = World()
    before = world.run("all")[0][-1].time
    assert world.time - before < 3 / 30  # cycles of 1/30 s


def test_a_controller_that_fails_is_asked_no_more_and_the_hand_retreats_first():
    """Whoever lets go at once drops what the hand holds in the air."""
    asked = []

    def fails(observation):
        asked.append(observation)
        if len(asked) == 3:
            raise ControllerError("step() raised ZeroDivisionError", source="mine.py", field="line 7")
        return observation.command

    world = World()
    cycles, message = world.run("", controller=fails, error=ControllerError)
    assert message == "mine.py: line 7: step() raised ZeroDivisionError"
    assert len(asked) == 3 and cycles[2].state == "safe"
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_controller_that_does_not_end_is_stopped_the_same_way():
    world = World()
    cycles, message = world.run("", time_limit=1.0)
    assert "still in phase 'approach' after 1 s" in message
    assert cycles[29].state == "running" and cycles[32].state == "safe"  # at 30 cycles a second
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_controller_cannot_close_blind():
    from dataclasses import replace

    world = World()
    world.run("camera", controller=lambda o: replace(o.command, opening=0.0, lift_height=1.0))
    at = world.sent[4].opening
    assert all(command.opening >= at for command in world.sent[5:])


def test_a_controller_cannot_exceed_the_limits():
    limits = Limits(opening=(0.01, 0.1), speed=0.1, force=5.0)
    sent = limits.apply(Command(0.5, 99.0, 9.0), Command(0.099, 1.0), 0.05)
    assert (sent.opening, sent.force_limit) == (0.1, 5.0)
    sent = limits.apply(Command(0.0, 1.0), Command(0.05, 1.0), 0.05)
    assert sent.opening == pytest.approx(0.05 - 0.1 * 0.05)
