"""The supervisor's state machine, and the control loop around it, on a rig of stubs."""

import math
import pickle
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile.core.errors import ControllerError
from mjtactile.core.types import Command, GripperState, Slip, TaskGoal, Touch, ValveState
from mjtactile.recording.observer import Observer
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.runtime import control_loop
from mjtactile.runtime.retreat import RETREAT_OPENING, RETREAT_SPEED
from mjtactile.runtime.supervisor import BLIND_TIME_MAX, Supervisor
from tests.stub_rig import BLIND, LAST, OK, PERIOD, SEALED, World, loaded


@pytest.fixture
def supervisor():
    supervisor = Supervisor(PERIOD)
    supervisor.arm(0.0)
    return supervisor


def test_the_reason_of_a_command_passes_limits_and_processes():
    requested = Command(0.04, 9.0, 0.03, "abort", {"t": 1.0}, reason="closed on nothing")
    sent = pickle.loads(pickle.dumps(CommandLimits(force=5.0).apply(requested, LAST, PERIOD)))
    assert (sent.reason, sent.force_limit, sent.memory["t"]) == ("closed on nothing", 5.0, 1.0)


@pytest.mark.parametrize(("how", "height"), [("slid", 0.02), ("pushed", 0.01), ("hangs", 0.0)])
def test_the_retreat_ends_when_the_held_object_stands(supervisor, how, height):
    """Until now a bottle that had slid down was driven into the table: down, then open."""
    slid = Slip("slipping", np.zeros(2), 0.02 if how == "slid" else 0.0, 0.0)
    last = Command(0.05, 4.0, 0.04, "hold")
    now = 0.0
    for _ in range(20):
        hanging = replace(loaded(-0.5), slip=slid)
        last = supervisor.decide(now, last, last, (hanging, hanging), ())
        now += PERIOD
    supervisor.make_safe("a reason", now)
    lowest = last.lift_height
    while not supervisor.is_over:
        up = 0.5 if how == "pushed" and last.lift_height < 0.01 else -0.5
        estimated = BLIND if how == "slid" else loaded(up)  # it slid off the membrane: no shape
        last = supervisor.decide(now, last, last, (estimated, estimated), ())
        lowest = min(lowest, last.lift_height)
        now += PERIOD
    # a step of the retreat is 1.5 mm
    assert lowest == pytest.approx(height, abs=2e-3)
    assert last.opening == pytest.approx(0.05 + RETREAT_OPENING, abs=1e-3)


def test_known_forces_do_not_change_the_command(supervisor):
    requested = Command(0.04, 4.0, 0.03, "hold")
    assert supervisor.decide(0.1, requested, LAST, (OK, OK), (SEALED, SEALED)) is requested
    assert supervisor.state == "running"


def test_with_an_unknown_force_the_gripper_neither_closes_nor_lifts(supervisor):
    sent = supervisor.decide(
        0.1, Command(0.04, 4.0, 0.03, "hold"), LAST, (OK, BLIND), (SEALED, SEALED)
    )
    assert (supervisor.state, supervisor.reason) == ("holding", "too dark")
    assert (sent.opening, sent.lift_height) == (LAST.opening, LAST.lift_height)
    opened = supervisor.decide(
        0.15, Command(0.06, 4.0, 0.01, "hold"), LAST, (BLIND, BLIND), (SEALED, SEALED)
    )
    assert (opened.opening, opened.lift_height) == (
        0.06,
        0.01,
    )  # commands in the safe direction pass
    supervisor.decide(0.2, LAST, LAST, (OK, OK), (SEALED, SEALED))
    assert supervisor.state == "running"


def test_a_long_loss_of_images_lowers_opens_and_latches(supervisor):
    last = LAST
    states = []
    heights = []
    for step in range(80):
        last = supervisor.decide(
            step * PERIOD,
            Command(0.03, 4.0, 0.05, "hold"),
            last,
            (BLIND, BLIND),
            (SEALED, SEALED),
            opening=last.opening,
        )
        states.append(supervisor.state)
        heights.append((last.lift_height, last.opening))
    assert states.index("safe") == math.floor(BLIND_TIME_MAX / PERIOD) + 1
    assert states[-1] == "latched"
    opened_at = next(i for i, (_, opening) in enumerate(heights) if opening > LAST.opening)
    assert heights[opened_at - 1][0] < 1e-3  # first down
    assert last.opening == pytest.approx(LAST.opening + RETREAT_OPENING, abs=2e-4)
    assert "no force for 0.5 s: too dark" in supervisor.reason


def test_the_safe_state_is_final(supervisor):
    supervisor.make_safe("overload", 0.0)
    supervisor.decide(0.1, Command(0.03, 4.0), LAST, (OK, OK), (SEALED, SEALED))
    assert supervisor.state == "safe"


@pytest.mark.parametrize("pressures", [(500.0, 1000.0), (1000.0, 600.0)])
def test_a_leak_is_found_by_pressure(supervisor, pressures):
    supervisor.decide(0.0, LAST, LAST, (OK, OK), (SEALED, SEALED))
    supervisor.decide(0.1, LAST, LAST, (OK, OK), tuple(ValveState(False, p) for p in pressures))
    assert supervisor.state == "safe"
    assert "lost pressure" in supervisor.reason


@pytest.mark.parametrize(("sealed", "later"), [(4.0, -2.0), (-996.0, -996.0)])
def test_a_chamber_at_ambient_pressure_does_not_leak(supervisor, sealed, later):
    for time, pressure in ((0.0, sealed), (0.1, later)):  # the noise of a sensor
        valve = ValveState(False, pressure)
        supervisor.decide(time, LAST, LAST, (OK, OK), (valve, valve))
    assert supervisor.state != "safe"


def test_a_leak_is_found_by_shape_without_a_sensor(supervisor):
    def seen(volume):
        return Touch(0.0, 0.0, 0.0, 0.01, False, surface=SimpleNamespace(volume=volume))  # type: ignore[arg-type]

    unknown = ValveState(False)
    supervisor.decide(0.0, LAST, LAST, (seen(1e-6), seen(1e-6)), (unknown, unknown))
    for step in range(3):
        supervisor.decide(
            0.1 + step * PERIOD, LAST, LAST, (seen(4e-7), seen(1e-6)), (unknown, unknown)
        )
    assert supervisor.state == "safe"
    assert "has sunk" in supervisor.reason


def test_a_membrane_under_an_unknown_force_does_not_leak(supervisor):
    """A wide face flattens the bulge: `round30`, a cube of 50 mm. The reason is that of the status."""

    def seen(force, volume):
        surface = SimpleNamespace(volume=volume)
        return Touch(0.0, 0.0, force, 0.01, False, surface=surface, status="on the frame")  # type: ignore[arg-type]

    supervisor.decide(0.0, LAST, LAST, (seen(0.0, 7e-7), OK), (SEALED, SEALED))
    for step in range(20):
        touch = (seen(math.nan, 3e-7), OK)
        supervisor.decide(0.1 + step * PERIOD, LAST, LAST, touch, (SEALED, SEALED))
    assert supervisor.state == "safe"
    assert "no force for 0.5 s: on the frame" in supervisor.reason


def test_the_jaws_open_when_the_measured_height_is_low(supervisor):
    """A stopped lift lags behind; a lift that stays up for a second is blocked."""
    supervisor.make_safe("a fault", 0.0)
    last = LAST
    opened = None
    for step in range(60):
        now = step * PERIOD
        height = max(0.0, 0.02 - 0.01 * now)  # 2 s, where the command takes 0.7 s
        last = supervisor.decide(now, last, last, (), (), height)
        opened = now if opened is None and last.opening > LAST.opening else opened
    assert opened == pytest.approx(0.02 / RETREAT_SPEED + 1.0, abs=2 * PERIOD)


def test_the_jaws_open_at_once_when_the_gripper_follows_its_command(supervisor):
    supervisor.make_safe("a fault", 0.0)
    last = LAST
    while last.opening == LAST.opening:
        last = supervisor.decide(0.1, last, last, (), (), last.lift_height)
    assert last.lift_height == 0.0


@pytest.mark.parametrize(
    ("place", "touch", "stood", "lands"),
    [
        (0.02, replace(OK, force_normal=0.0, touching=False), False, True),
        (0.02, OK, False, False),  # it still holds an object
        (0.02, BLIND, False, False),  # or may
        (0.0, replace(OK, force_normal=0.0, touching=False), False, False),
        (0.0, replace(OK, force_normal=0.0, touching=False), True, True),
        (0.0, OK, True, False),
    ],
    ids=["empty", "holds", "blind", "no other place", "it stood", "stood and is held again"],
)
def test_an_empty_gripper_is_not_lowered_into_its_target(supervisor, place, touch, stood, lands):
    rig = SimpleNamespace(goal=TaskGoal(place_height=place))
    last = Command(0.06, 4.0, 0.025, "done")
    gripper = GripperState(0.06, 0.0, 0.0, 0.025)
    cycle = SimpleNamespace(
        rig=rig,
        last=last,
        touch=(touch,),
        supervisor=supervisor,
        now=1.0,
        gripper=gripper,
        set_down=SimpleNamespace(stood=stood),
    )
    assert control_loop._has_landed(cycle) == lands and (supervisor.state == "safe") != lands  # type: ignore[arg-type]


# -- the loop
# --------------------------------------------------------------------------------


def test_a_stale_camera_holds_then_opens_and_the_run_ends():
    world = World()
    cycles, message = world.run("camera")
    assert message.startswith("stopped safely: no force for 0.5 s: left camera is stale")
    assert [c.state for c in cycles[5:7]] == ["holding", "holding"]
    assert math.isnan(cycles[5].touch[0].force_normal)  # unknown, neither zero nor the last value
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_servo_fault_leads_to_the_safe_state_with_its_reason():
    """Its touch remains and its jaws are not measured: they were opened without verification."""
    world = World()
    cycles, message = world.run("gripper")
    assert message == (
        "stopped, not verified safe: servo 1 reports overload; the opening is unknown, the forces "
        "are 0.50 N"
    )
    assert len(cycles) == len(world.sent)  # every turn is recorded, the retreat too
    assert all(
        math.isnan(cycle.gripper.opening) and cycle.reason == "servo 1 reports overload"
        for cycle in cycles[5:]
    )
    assert cycles[-1].state == "latched" and cycles[-1].touch == (OK,)
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_without_a_responding_device_the_run_ends_at_once():
    world = World()
    cycles, message = world.run("all")
    assert len(cycles) == 6 and cycles[-1].state == "latched"
    assert message == (
        "stopped, not verified safe: servo 1 reports overload; the last command was not carried out"
    )


def test_a_failed_controller_is_not_called_again_and_the_gripper_retreats():
    """A failed controller is not called again, and the gripper retreats before it opens.

    To open immediately would drop an object held in the air.
    """
    asked = []

    def fails(observation):
        asked.append(observation)
        if len(asked) == 3:
            raise ControllerError(
                "step() raised ZeroDivisionError", source="mine.py", field="line 7"
            )
        return observation.command

    world = World()
    cycles, message = world.run("", controller=fails, error=ControllerError)
    assert message == "mine.py: line 7: step() raised ZeroDivisionError"
    assert len(asked) == 3 and cycles[2].state == "safe"
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_controller_that_does_not_return_is_stopped_like_a_failed_controller():
    world = World()
    cycles, message = world.run("", time_limit=1.0)
    assert "still in phase 'approach' after 1 s" in message
    assert cycles[29].state == "running" and cycles[32].state == "safe"  # at 30 cycles a second
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def retreat(opening, touch=OK, last=LAST, time=5.0):
    """Return supervisor and commands of a retreat on the table; `opening`, m, is measured after
    each command."""
    supervisor = Supervisor(PERIOD)
    supervisor.make_safe("a fault", 0.0)
    last = replace(last, lift_height=0.0)
    sent = [last]
    for step in range(round(time / PERIOD)):
        last = supervisor.decide(
            step * PERIOD, last, last, (touch, touch), (), 0.0, opening(last.opening)
        )
        sent.append(last)
    return supervisor, sent


def test_the_retreat_starts_from_the_measured_opening():
    """A goal 20 mm ahead of the jaws, plus 15 mm, was behind them: they stayed closed."""
    supervisor, sent = retreat(lambda goal: max(goal, LAST.opening + 0.020))
    assert supervisor.is_over and not supervisor.unverified
    assert sent[-1].opening == pytest.approx(LAST.opening + 0.020 + RETREAT_OPENING)
    assert all(after.opening >= before.opening for before, after in pairwise(sent))


def test_jaws_that_stay_closed_are_not_safe():
    supervisor, _ = retreat(lambda goal: LAST.opening)
    assert supervisor.is_over
    assert supervisor.unverified == (
        "the jaws are at 50.0 mm instead of 65.0 mm, the forces are 0.50 N, 0.50 N"
    )


def test_vanished_forces_verify_a_release_without_measured_openings():
    free = replace(OK, force_normal=0.0, touching=False)
    assert not retreat(lambda goal: None, free)[0].unverified
    assert retreat(lambda goal: None, BLIND)[0].unverified == (
        "the opening is unknown, the forces are unknown, unknown"
    )


@pytest.mark.parametrize(("limit", "opens_with"), [(0.0, 4.0), (None, 4.0), (6.0, 6.0)])
def test_a_gripper_with_a_low_force_limit_can_open(limit, opens_with):
    _, sent = retreat(lambda goal: goal, last=replace(LAST, force_limit=limit))
    assert sent[-1].force_limit == opens_with


def test_the_force_is_not_raised_while_the_goal_still_closes_the_jaws():
    _, sent = retreat(lambda goal: LAST.opening + 0.005, last=replace(LAST, force_limit=1.0))
    assert {item.force_limit for item in sent if item.opening < LAST.opening + 0.005} == {1.0}


def test_time_of_the_retreat_includes_the_height():
    """A raised gripper lowers before it opens. 5 s are 0.15 m: from a greater height the held
    object was dropped.
    """
    _, sent = retreat_from(0.4)
    opened = next(item for item in sent if item.opening > LAST.opening)
    assert opened.lift_height < 1e-3


def retreat_from(height):
    supervisor = Supervisor(PERIOD)
    supervisor.make_safe("a fault", 0.0)
    sent = [replace(LAST, lift_height=height)]
    while not supervisor.is_over:
        last = sent[-1]
        sent.append(supervisor.decide(0.1, last, last, (OK,), (), last.lift_height, last.opening))
    return supervisor, sent


def test_a_gripper_measured_above_the_table_is_not_down(supervisor):
    """A lift lags: its command is down, the gripper is not."""
    up = GripperState(0.06, 0.0, 0.0, 0.02)
    cycle = SimpleNamespace(
        rig=SimpleNamespace(goal=TaskGoal()),
        last=Command(0.06, 4.0, 0.0, "done"),
        touch=(OK,),
        supervisor=supervisor,
        now=1.0,
        gripper=up,
        set_down=SimpleNamespace(stood=False),
    )
    assert not control_loop._has_landed(cycle) and supervisor.state == "safe"  # type: ignore[arg-type]


def test_stuck_jaws_after_a_controller_that_raises_are_reported_and_recorded():
    facts = {}
    reported = []

    class NoteObserver(Observer):
        def note(self, **new):
            facts.update(new)

        def message(self, text):
            reported.append(text)

    def fails(observation):
        world.stuck = True
        raise ControllerError("boom")

    world = World()
    _, message = world.run("", controller=fails, error=ControllerError, observer=NoteObserver())
    assert message == "boom"
    assert reported == [f"not verified safe: {facts['not_verified_safe']}"]
    assert facts["not_verified_safe"].startswith("the jaws are at 50.0 mm instead of 65.0 mm")


def test_a_retreat_ends_at_the_end_stop_of_the_jaws():
    supervisor = Supervisor(PERIOD)
    supervisor.make_safe("a fault", 0.0)
    last = replace(LAST, lift_height=0.0)
    widest = LAST.opening + 0.004
    for step in range(8):
        last = supervisor.decide(step * PERIOD, last, last, (), (), 0.0, last.opening)
        last = replace(last, opening=min(last.opening, widest))  # as the rig's limits do
    assert supervisor.is_over
