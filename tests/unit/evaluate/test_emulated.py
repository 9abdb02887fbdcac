"""Tests of episodes on emulated rigs: the emulated world scores them, and unsupported requests are
rejected."""

from types import SimpleNamespace

import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.evaluate import emulated


def outcome_of(heights, *, press=0.2, last="done", believed="not set down"):
    """Return the outcome of a run with the object at these heights, m: before the lift, lifted by
    40 mm, and set down."""
    moments = [
        {"object_height": height, "lift_height": lift, "contact_1": press, "contact_2": press}
        for height, lift in zip(heights, (0.0, 0.04, 0.003), strict=True)
    ]
    true = emulated.TrueOutcome(break_force=1.0)
    true.start(SimpleNamespace(rig=SimpleNamespace(truth=lambda: moments[0])))
    for phase, moment in (("approach", 0), ("hold", 1), (last, 2)):
        true._truth = lambda moment=moment: moments[moment]
        true.add(SimpleNamespace(sent=SimpleNamespace(phase=phase)))
    return true.score({"outcome": believed, "reason": "reported"})


def test_an_object_that_was_lifted_and_set_down_was_held():
    found = outcome_of((0.02, 0.06, 0.021))
    assert found["outcome"] == "held" and found["reason"] == ""
    assert found["hold_force_true_N"] == pytest.approx(0.2)
    assert (
        outcome_of((0.02, 0.03, 0.02), believed="held")["outcome"] == "dropped"
    )  # it stayed behind
    assert (
        outcome_of((0.02, 0.06, 0.06), believed="held")["outcome"] == "dropped"
    )  # it does not stand
    assert outcome_of((0.02, 0.06, 0.02), last="abort")["outcome"] == "dropped"
    assert outcome_of((0.02, 0.06, 0.02), press=1.1)["outcome"] == "crushed"


def test_features_without_emulation_are_refused():
    assert emulated.check(Scenario(rig="emulated"))
    assert emulated.check(Scenario(rig="emulated", task="place"))
    assert not emulated.check(Scenario(rig="sim", task="pour", randomization="default"))
    with pytest.raises(InputError, match="--task: the disturbances of 'pour'"):
        emulated.check(Scenario(rig="emulated", task="pour"))
    with pytest.raises(InputError, match="--randomization: an emulated world"):
        emulated.check(Scenario(rig="emulated", randomization="default"))
