"""Tests of the outcome of a grasp on a rig without ground truth, from the controller's estimate and
the measurements."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mjtactile.commands.grasp import EXIT_CODES, exit_code
from mjtactile.core.scenario import Scenario
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Command, Touch, ValveState
from mjtactile.recording.observer import Observer
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.runtime.failure_causes import failure_causes
from mjtactile.runtime.grasp import _Log, _result, run_grasp
from mjtactile.runtime.set_down import SetDown
from tests.emulated_host import controller_text

HELD = Touch(0.0, 0.0, 0.6, 0.01, True)
EMPTY = Touch(0.0, 0.0, 0.0, 0.01, False)
UNKNOWN = Touch(0.0, 0.0, math.nan, math.nan, False)


def cycle(touch: Touch, command: Command) -> Any:
    times = {"camera_ms": 1.0, "perception_ms": 1.0, "controller_ms": 1.0}
    facts = {"gripper": SimpleNamespace(opening=0.04), "valves": (), "time": 0.0}
    return SimpleNamespace(touch=(touch,), sent=command, **facts, **times)


@pytest.mark.parametrize(
    ("touch", "height", "phase", "outcome"),
    [
        (HELD, 0.04, "done", "not set down"),
        (UNKNOWN, 0.04, "done", "not set down"),
        (EMPTY, 0.04, "done", "dropped"),
        (EMPTY, 0.0, "done", "held"),
        (EMPTY, 9e-4, "done", "held"),  # a policy releases below 1 mm
        (EMPTY, 12e-4, "done", "dropped"),
        (HELD, 0.04, "abort", "not held: set down"),  # by the retreat
        (EMPTY, 0.04, "abort", "dropped"),
        (UNKNOWN, 0.04, "abort", "dropped"),
    ],
)
def test_a_controller_that_ends_with_the_gripper_up_has_not_set_down(touch, height, phase, outcome):
    log = _Log(Observer(), None, None)
    log.add(cycle(HELD, Command(0.05, 4.0, 0.04, "hold")))
    log.add(cycle(touch, Command(0.05, 4.0, height, phase)))
    log.add(cycle(EMPTY, Command(0.06, 4.0, 0.0, phase)))  # the retreat
    found = _result(Scenario(), log, 1.0, completed=phase == "done", period=1 / 30)
    assert found.outcome == outcome
    assert bool(found.reason) == (outcome != "held")


def aborted(*changes, touch=HELD, last=EMPTY, height=0.0):
    """Return the result of a hold that the controller aborts; `changes` apply to the cycle in
    between."""
    log = _Log(Observer(), None, None)
    first = cycle(HELD, Command(0.05, 4.0, 0.04, "hold"))
    second = cycle(touch, Command(0.05, 4.0, 0.04, "hold"))
    second.time = 0.03
    first.valves = second.valves = (ValveState(False, 1000.0),)
    for name, value in changes:
        setattr(second, name, value)
    ends = [
        cycle(touch, Command(0.05, 4.0, 0.04, "abort")),
        cycle(touch, Command(0.05, 4.0, height, "abort")),
        cycle(last, Command(0.06, 4.0, height, "abort")),
    ]
    for number, one in enumerate([first, second, *ends]):
        one.time = one.time or 0.03 * number
        log.add(one)
    return _result(Scenario(), log, 1.0, completed=False, period=1 / 30)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (("time", 0.9), "the loop was stopped for 0.90 s"),
        (("gripper", SimpleNamespace(opening=math.nan)), "the gripper did not answer"),
        (("valves", (ValveState(True, 0.0),)), "a valve opened by itself"),
        (
            ("touch", (replace(HELD, status=Status(StatusCode.NO_IMAGE, "no image for 1 s")),)),
            "no image for 1 s",
        ),
    ],
)
def test_a_device_that_ended_a_grasp_is_its_cause(change, fault):
    """The object stands, and the exit code is that of a device fault."""
    found = aborted(change)
    assert found.outcome == "not held: set down"
    assert fault in found.device_fault and fault in found.reason
    assert found.summary()["device_fault"] == found.device_fault
    assert EXIT_CODES[found.outcome] == 1 and exit_code(found.summary()) == 3


def test_an_abort_without_a_device_fault_is_the_controllers():
    found = aborted()
    assert (found.outcome, found.device_fault) == ("not held: set down", "")
    assert exit_code(found.summary()) == 1
    assert "device_fault" not in found.summary()
    assert aborted(height=0.03).outcome == "dropped"  # it opened in the air
    assert aborted(touch=EMPTY).outcome == "dropped"  # it had lost the object
    regulated = ("sent", Command(0.05, 4.0, 0.04, "hold", gauge_pressure=(0.0,)))
    opened = ("valves", (ValveState(True, 0.0),))
    assert aborted(opened, regulated).device_fault == ""  # the controller vents


def test_an_empty_gripper_has_not_set_down():
    """The gripper closed without an object at the height of the table."""
    log = _Log(Observer(), None, None)
    for phase, opening in (("close", 0.05), ("abort", 0.05), ("abort", 0.06)):
        log.add(cycle(EMPTY, Command(opening, 4.0, 0.0, phase)))
    assert _result(Scenario(), log, 1.0, completed=False, period=1 / 30).outcome == "dropped"


def loaded(*down: float) -> tuple[Touch, ...]:
    """Return fingers with these loads, N, along their -y axes, and 1 N of grip."""
    wrenches = [np.array([0.0, -force, -1.0, 0.0, 0.0, 0.0]) for force in down]
    tractions = [SimpleNamespace(wrench=wrench, wrench_cov=np.eye(6)) for wrench in wrenches]
    return tuple(Touch(0.0, 0.0, 1.0, 0.01, True, traction=traction) for traction in tractions)  # type: ignore


@pytest.mark.parametrize(
    ("held", "released", "height", "outcome"),
    [
        (0.3, 0.10, 0.003, "held"),  # the table carries two thirds
        (0.3, -0.1, 0.003, "held"),  # it pushes up
        (0.3, 0.28, 0.003, "dropped"),  # released in the air
        (0.3, 0.28, 9e-4, "held"),  # the gripper is down
        (0.3, math.nan, 0.003, "dropped"),
        (0.02, 0.0, 0.003, "dropped"),  # the load is within the noise
    ],
)
def test_an_object_on_the_table_when_the_fingers_open_is_set_down(held, released, height, outcome):
    """The gripper may end above its start: the object had slipped, or touched the table earlier.
    The decision of the scoring without ground truth is the same as that of the control loop."""
    log = _Log(Observer(), None, None)
    rule = SetDown()
    steps = [
        (loaded(held, held), "hold", 0.04),
        (loaded(held, held), "lower", 0.02),
        (loaded(released, released), "release", height),
        ((EMPTY, EMPTY), "done", height),
    ]
    for touch, phase, at in steps:
        command = Command(0.05, 4.0, at, phase)
        one = cycle(HELD, command)
        one.touch = touch
        log.add(one)
        rule.watch(touch, command)
    found = _result(Scenario(), log, 1.0, completed=True, period=1 / 30)
    assert found.outcome == outcome and rule.stood == (outcome == "held")
    assert found.outcome_from == "estimates"


@pytest.mark.parametrize(
    ("available", "opening", "flags", "found"),
    [
        (lambda x: 50 * x, 0.04, {}, ["at most 2 N at an opening of 40.0 mm"]),
        (lambda x: 50 * x, None, {}, []),
        (lambda x: 8.0, 0.04, {}, []),
        (None, 0.04, {"frame_contact": "blocked by 'stand' with 7.7 N; move it"}, ["with 7.7 N"]),
        (None, 0.04, {"carrier_contact": "'pad' carries 2 N", "speed": "fast"}, ["carries 2 N"]),
    ],
)
def test_a_failed_grasp_names_the_forces_outside_of_the_controller(
    available, opening, flags, found
):
    """The remedy of a flag and flags of accuracy are no causes; nor are actuators that suffice."""
    rig = SimpleNamespace(grip_force_available=available, limits=CommandLimits(force=8.0))
    causes = failure_causes(rig, flags, opening)  # type: ignore[arg-type]
    assert len(causes) == len(found)
    assert all(words in cause for words, cause in zip(found, causes, strict=True))
    assert not any("; move" in cause for cause in causes)


def test_jaws_blocked_by_the_stand_are_reported(tmp_path):
    """Posts next to a test tube stop the frames of the sensors before the membranes are loaded."""
    post = '<geom name="{}" type="capsule" fromto="{} .0053 0 {} .0053 0.03" size="0.0012"/>'
    posts = post.format("left_post", -0.0053, -0.0053) + post.format("right_post", 0.0053, 0.0053)
    tube = tmp_path / "tube.xml"
    tube.write_text(
        f"""<mujoco><custom><numeric name="break_force_N" data="4"/><text name="material"
        data="solid"/></custom><worldbody>{posts}<body name="object" pos="0 0 0.045"><freejoint/>
        <geom type="cylinder" size="0.006 0.045" mass="0.012"/></body></worldbody></mujoco>"""
    )
    (tmp_path / "quick.py").write_text(controller_text(hold=0.1))
    scenario = Scenario(
        object=str(tube),
        sensor="dense",
        effects="-mesh,-pipeline",
        controller=str(tmp_path / "quick.py"),
        time_limit=20.0,
    )
    result = run_grasp(scenario)
    assert result.outcome == "not held: set down"  # the tube still stands
    assert "the frame of sensor" in result.reason and "_post' with " in result.reason
    assert float(result.reason.split("with ")[1].split(" N")[0]) > 1.0
