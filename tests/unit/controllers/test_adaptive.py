"""The adaptive controller follows load and friction, and neither a lean nor a bump fools it: on
touches that are made up by statics."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mjtactile.core.types import (
    Command,
    GripperState,
    Observation,
    Slip,
    SlipState,
    TaskGoal,
    Touch,
    Traction,
)
from mjtactile.grasp_estimation import GripStiffnessEstimator
from mjtactile.runtime.controller import load_controller

PERIOD = 1 / 30
GRID = np.linspace(-0.01, 0.01, 3)
step = load_controller("adaptive").step
TEST_RISK, HOLD_FORCE = 0.5, 0.3


def finger(down, side=0.0, normal=0.4, state: SlipState = "sticking"):
    """A finger whose y points up: it carries `down` N, and `side` N along x."""
    wrench = np.array([side, -down, -normal, 0.0, 0.0, 0.0])
    traction = Traction(GRID, GRID, np.zeros((3, 3, 3)), wrench, np.eye(6) * 9e-6, 1e3, "made up")
    slip = Slip(state, np.zeros(2), 0.0, 1.0)
    return Touch(0.0, 0.01, normal, 0.003, normal > 0.05, traction=traction, slip=slip)


def run(command, touch_at, count, goal=None):
    """Run `count` cycles on a gripper that reaches every goal immediately; `touch_at(k, command)` gives
    the touches."""
    for k in range(count):
        state = GripperState(command.opening, 0.0, 0.4, command.lift_height)
        estimated = touch_at(k, command)
        command = step(
            Observation(k * PERIOD, PERIOD, estimated, state, (), command, goal or TaskGoal())
        )
    return command


def holding(load=0.2, goal=None):
    """A command that has lifted `load` N on each finger, gripped as it asked for, and holds."""
    start = Command(0.04, 5.0, 0.0, "lift")
    goal = goal or TaskGoal(hold_time=60.0)
    both = lambda k, c: (finger(load, normal=c.memory.get("target", 0.3)),) * 2  # noqa: E731
    command = run(start, both, 150, goal)
    assert command.phase == "hold"
    return command, goal


@pytest.mark.parametrize("friction", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("weight", [0.1, 0.3])
def test_friction_is_found_before_it_lifts_on(friction, weight):
    """The test estimates the friction before the lift continues, and the grip keeps a margin.

    Coulomb: an object of `weight` N on each finger leaves the table within half a millimeter, and
    slides where the grip is too light. At most the median of the posterior is tested for two
    seconds; the grip keeps 0.02 N of load in reserve.
    """
    grips = []

    def touch_at(k, command):
        grips.append(command.memory.get("target", 0.3))
        grip = grips[max(0, k - 3)]
        carried = min(1.0, command.lift_height / 5e-4) * weight
        return (finger(min(carried, friction * grip), normal=grip),) * 2

    goal = TaskGoal(hold_time=60.0)
    command = run(Command(0.04, 5.0, 0.0, "lift"), touch_at, 240, goal)
    assert command.phase == "hold"
    required = weight / friction
    margin = command.memory["target"] / required
    assert 1.0 < margin < max(1.7 * (1 + 0.02 / weight), 1.01 * HOLD_FORCE / required)


def test_a_light_object_is_lifted_without_a_test_of_its_friction():
    """2.7 g use 0.13 of 0.1 N, the lightest grip of the test: friction is certainly higher."""
    risks = []

    def light(k, command):
        risks.append(command.memory.get("risk"))
        return (finger(min(0.013, 26 * command.lift_height)),) * 2

    command = run(Command(0.04, 5.0, 0.0, "lift"), light, 100, TaskGoal(hold_time=60.0))
    assert command.phase == "hold" and TEST_RISK not in risks
    # in reserve for what may be put on it: the jaws follow 0.1 s later
    assert command.memory["target"] == HOLD_FORCE


def test_it_estimates_the_weight_of_the_lifted_object():
    command, _ = holding(0.2)
    mass = command.memory["mass"]
    assert mass == pytest.approx(0.4 / 9.81, rel=1e-6)
    # 3 mN of noise on each finger, and 1.5 %
    sd = math.hypot(math.sqrt(2) * 0.003, 0.015 * 0.4) / 9.81
    assert command.memory["mass_sd"] == pytest.approx(sd, rel=1e-3)


def test_the_grip_goes_with_the_load_and_comes_back_slowly():
    command, goal = holding(0.2)
    before = command.memory["target"]
    more = run(command, lambda k, c: (finger(0.4, normal=1.0),) * 2, 10, goal)
    assert more.memory["target"] == pytest.approx(2 * before, rel=0.1)
    less = run(more, lambda k, c: (finger(0.2, normal=1.0),) * 2, 6, goal)
    assert less.memory["target"] > 1.5 * before  # half of a shake is light
    less = run(less, lambda k, c: (finger(0.2, normal=1.0),) * 2, 120, goal)
    # these fingers press harder than commanded: friction that is not in use may have fallen
    assert before < less.memory["target"] < 1.6 * before


def test_a_long_hold_keeps_its_grip():
    """The fingers press as commanded: friction stays in use, so the grip grows by a fifth at most
    in 16 s."""
    command, goal = holding(0.2)
    held = run(command, lambda k, c: (finger(0.2, normal=c.memory["target"]),) * 2, 480, goal)
    assert 0.9 < held.memory["target"] / command.memory["target"] < 1.2


def test_an_object_that_leans_in_the_grip_is_no_load():
    """One finger is dragged up and the other down, the more the harder they press: gripping for
    that would never end."""
    command, goal = holding(0.2)
    before = command.memory["target"]

    def lean(k, now):
        target = now.memory["target"]
        inner = 0.5 * target
        return finger(0.2 + inner, normal=target), finger(0.2 - inner, normal=target)

    assert run(command, lean, 60, goal).memory["target"] == pytest.approx(before, rel=0.1)


def test_a_slip_that_all_fingers_report_tightens_the_grip_at_once():
    command, goal = holding(0.2)
    kept: Any = command.memory
    grip = kept["target"]

    def report(*states, way=1e-3):
        def touch_at(k, now):
            slips = [finger(0.2, normal=grip, state=state) for state in states]
            moved = [replace(one.slip, distance=way * (k + 1)) for one in slips]
            return tuple(replace(one, slip=slip) for one, slip in zip(slips, moved, strict=True))

        return touch_at

    alone = run(command, report("slipping", "sticking"), 3, goal)
    still = run(command, report("slipping", "sticking", way=0.0), 3, goal)
    assert still.memory["target"] < 1.5 * grip  # a report lasts for several images
    one = run(command, report("slipping", "slipping"), 1, goal)
    more = one.memory["target"] - grip
    # within a cycle it closes by the compression of two membranes from one force to the other
    spring = GripStiffnessEstimator(**kept["spring"])
    assert more > 0.2 * grip
    compression = min(spring.way(grip, grip + more), 0.006)
    assert one.opening == pytest.approx(command.opening - compression, abs=1.2e-4)
    both = run(command, report("slipping", "slipping"), 3, goal)
    # a finger that slides measures the friction, whatever the other one does
    assert both.memory["target"] >= alone.memory["target"] > 1.5 * grip


def test_it_releases_where_a_person_pulls_and_not_at_a_bump():
    goal = TaskGoal(hold_time=60.0, handover=True)
    command, _ = holding(0.2, goal)

    def pulled(count):
        return lambda k, c: (finger(0.0 if k < count else 0.2, normal=0.5),) * 2

    assert run(command, pulled(2), 10, goal).phase == "hold"  # 0.07 s
    assert run(command, pulled(99), 10, goal).phase == "release"
    alone, plain = holding(0.2)
    assert run(alone, pulled(99), 10, plain).phase == "hold"  # no handover was announced


@pytest.mark.parametrize("load", [0.03, 0.2, 1.0])
def test_it_sets_down_where_the_table_takes_the_load(load):
    command, _ = holding(load, TaskGoal(hold_time=60.0))
    command = replace(command, phase="lower")

    def table(k, now):
        """At 17 mm; the membranes give way by 1 N for 5 mm."""
        carried = load - max(0.017 - now.lift_height, 0.0) * 200
        return (finger(carried, normal=max(0.3, 2 * load)),) * 2

    down = run(command, table, 90)
    assert down.phase == "release"
    # depth from the load, 7 mm/s for two cycles of delay, and the threshold for the end of the
    # weight
    assert 0.017 - load / 200 - 0.002 < down.lift_height < 0.0175


def test_one_image_without_load_is_not_the_table():
    """An error of one image does not release the object in the air."""
    command, goal = holding(0.2)
    command = replace(command, phase="lower")
    lowered = run(command, lambda k, c: (finger(0.0 if k == 3 else 0.2, normal=0.4),) * 2, 12, goal)
    assert lowered.phase == "lower"


def test_a_load_that_vanishes_far_above_the_table_is_no_table():
    """At 36 mm above the specified height, beyond the 30 mm of the search, the object swings."""
    command, goal = holding(0.2)
    command = replace(command, phase="lower")

    def swings(k, now):
        is_light = 0.035 < now.lift_height < 0.037
        return (finger(0.0 if is_light else 0.2, normal=0.4),) * 2

    lowered = run(command, swings, 30, goal)
    assert lowered.phase == "lower"
    assert lowered.lift_height < 0.03


def test_the_jaws_stop_at_the_first_contact():
    """They lag behind the command by 2 mm, which would compress a stiff object further.

    The first detected contact counts, below the force that settles both fingers: at 20 mm/s each
    image is 0.7 mm, 0.3 N of a stiff box.
    """
    state = GripperState(0.042, -0.02, 0.4, 0.0)
    moving = Command(0.040, 5.0, 0.0, "approach")
    cases = (((0.06, 0.0), "close"), ((0.2, 0.0), "close"), ((0.2, 0.2), "regulate"))
    for forces, phase in cases:
        touch = tuple(finger(0.0, normal=force) for force in forces)
        command = step(Observation(0.0, PERIOD, touch, state, (), moving, TaskGoal()))
        assert command.phase == phase
        assert command.opening == state.opening


def test_a_heavy_object_that_stands_off_center_is_lifted():
    """The table holds it against one finger, which pushes with 0.5 N, the other with 0.08 N.

    The force of the weaker finger counts: half of the first target of 0.18 N, within its
    tolerance.
    """
    lagging = Command(0.04, 5.0, 0.0, "regulate")
    pushed = lambda k, c: (finger(0.0, normal=0.5), finger(0.0, normal=0.08))  # noqa: E731
    assert run(lagging, pushed, 15).phase == "lift"
    alone = lambda k, c: (finger(0.0, normal=0.5), finger(0.0, normal=0.01))  # noqa: E731
    assert run(lagging, alone, 15).phase == "regulate"


def test_an_unknown_estimate_stops_it():
    command, goal = holding(0.2)
    blind = replace(finger(0.2), force_normal=math.nan, traction=None, status="too dark")
    assert run(command, lambda k, c: (blind, finger(0.2)), 6, goal).phase == "hold"
    over = run(command, lambda k, c: (blind, finger(0.2)), 20, goal)
    assert over.phase == "abort" and over.reason == "the contact force is unknown: too dark"


def test_a_slip_that_does_not_end_delays_the_lift_only():
    """Self-stress keeps one face of a domino at its friction limit: slip is reported all the time."""

    def stressed(k, command):
        normal = command.memory.get("target", 0.18)
        carried = 0.05 * min(1.0, command.lift_height / 5e-4)
        slipping = finger(carried, 0.7 * normal, normal, "slipping")
        distance = replace(slipping.slip, distance=1e-4 * k)
        return finger(carried, -0.4 * normal, normal), replace(slipping, slip=distance)

    start = Command(0.04, 5.0, 0.0, "lift")
    assert run(start, stressed, 450, TaskGoal(hold_time=60.0)).phase == "hold"


def test_an_object_that_slides_while_its_load_grows_is_lifted_slowly():
    """The table carries the rest of 0.6 N on each finger, which slide up along it at mu = 0.6.

    At 30 mm/s it would slide out of the fingers. The limit of the speed is that of the first 3 mm.
    """
    steps = []

    def sliding(k, command):
        load = min(0.6, 0.05 + 60 * command.lift_height)
        steps.append((command.lift_height, load))
        slip = Slip("slipping", np.zeros(2), 1e-4 * k, 1.0)
        return (replace(finger(load, normal=load / 0.6), slip=slip),) * 2

    run(Command(0.04, 5.0, 0.0, "lift"), sliding, 450, TaskGoal(hold_time=60.0))
    height, load = np.array(steps).T
    assert load[-1] == 0.6
    assert np.diff(height)[load[1:] < 0.6].max() < 1.01 * 0.003 * PERIOD


def test_an_object_that_slides_in_the_air_is_lifted_slowly():
    """It slides from 15 mm on, for longer than the second that the lift waits.

    The limit of the speed is that of the first 3 mm.
    """
    heights = []

    def sliding(k, command):
        heights.append(command.lift_height)
        if command.lift_height < 0.015:
            return (finger(0.2, normal=command.memory.get("target", 0.3)),) * 2
        slip = Slip("slipping", np.zeros(2), 1e-4 * k, 1.0)
        return (replace(finger(0.2, normal=0.3), slip=slip),) * 2

    run(Command(0.04, 5.0, 0.0, "lift"), sliding, 300, TaskGoal(hold_time=60.0))
    height = np.array(heights)
    assert height[-1] > 0.017
    assert np.diff(height)[height[1:] > 0.016].max() < 1.01 * 0.003 * PERIOD


def test_the_lift_starts_gently():
    """A start at 30 mm/s within an image adds a third of the weight; 0.1 m/s^2 adds a hundredth.

    It starts at the 3 mm/s of the first lift.
    """
    heights = []

    def carried(k, command):
        heights.append(command.lift_height)
        load = min(0.2, 0.05 + 60 * command.lift_height)
        return (finger(load, normal=command.memory.get("target", 0.3)),) * 2

    run(Command(0.04, 5.0, 0.0, "lift"), carried, 300, TaskGoal(hold_time=60.0))
    speeds = np.diff(heights) / PERIOD
    assert speeds.max() == pytest.approx(0.03, rel=1e-6)
    assert np.diff(speeds).max() < 0.003 + 1.01 * 0.1 * PERIOD


def test_lowering_changes_its_speed_gently():
    """A start at 30 mm/s within an image unloads the fingers like the table.

    From rest to 30 mm/s, and 7 mm/s near the table, with 0.1 m/s^2.
    """
    goal = TaskGoal(hold_time=0.1)
    heights = []

    def carried(k, command):
        if command.phase == "lower":
            heights.append(command.lift_height)
        return (finger(0.2, normal=command.memory.get("target", 0.3)),) * 2

    run(holding(0.2)[0], carried, 90, goal)
    speeds = -np.diff(heights) / PERIOD
    assert speeds[0] < 0.004
    assert speeds.max() == pytest.approx(0.03, rel=1e-6)
    assert speeds[-1] == pytest.approx(0.007, rel=1e-6)
    assert np.abs(np.diff(speeds)).max() < 1.01 * 0.1 * PERIOD


def test_it_lifts_only_after_contact_of_all_fingers():
    """An egg in its cup resists one finger."""
    start = Command(0.04, 5.0, 0.0, "regulate")
    one_sided = lambda k, c: (finger(0.0, normal=0.36), finger(0.0, normal=0.0))  # noqa: E731
    command = run(start, one_sided, 30)
    assert command.phase == "regulate"
    assert command.opening < start.opening - 1e-3  # on towards the other finger
    both = lambda k, c: (finger(0.0, normal=0.18),) * 2  # noqa: E731
    assert run(command, both, 30).phase == "lift"
