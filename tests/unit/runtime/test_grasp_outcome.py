"""Tests of the outcome of a grasp on a rig without ground truth, from the controller's estimate and
the measurements."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Command, Touch
from mjtactile.recording.observer import Observer
from mjtactile.runtime.grasp import _Log, _result

HELD = Touch(0.0, 0.0, 0.6, 0.01, True)
EMPTY = Touch(0.0, 0.0, 0.0, 0.01, False)
UNKNOWN = Touch(0.0, 0.0, math.nan, math.nan, False)


def cycle(touch: Touch, command: Command) -> Any:
    times = {"camera_ms": 1.0, "perception_ms": 1.0, "controller_ms": 1.0}
    return SimpleNamespace(touch=(touch,), sent=command, **times)


@pytest.mark.parametrize(
    ("touch", "height", "phase", "outcome"),
    [
        (HELD, 0.04, "done", "not set down"),
        (UNKNOWN, 0.04, "done", "not set down"),
        (EMPTY, 0.04, "done", "dropped"),
        (EMPTY, 0.0, "done", "held"),
        (HELD, 0.04, "abort", "dropped"),
    ],
)
def test_who_ends_with_the_hand_up_has_not_set_down(touch, height, phase, outcome):
    log = _Log(Observer(), None, None)
    log.add(cycle(HELD, Command(0.05, 4.0, 0.04, "hold")))
    log.add(cycle(touch, Command(0.05, 4.0, height, phase)))
    log.add(cycle(EMPTY, Command(0.06, 4.0, 0.0, phase)))  # the retreat
    found = _result(Scenario(), log, 1.0, completed=phase == "done", period=1 / 30)
    assert found.outcome == outcome
    assert bool(found.reason) == (outcome != "held")
