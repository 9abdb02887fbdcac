"""Tests of the benefit of touch: its table matches its lines, and the slip test depends on
subsequent events."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.slip import active_slip_test
from benchmarks.tasks.figure import plot
from benchmarks.tasks.run import TASKS, run, suite_of, table, together, weighed
from benchmarks.tasks.simulation_levels import agreement
from mjtactile.core.errors import InputError
from mjtactile.core.types import Slip, Touch, Traction
from mjtactile.evaluate.statistics import summarise

GRID = np.linspace(-0.01, 0.01, 3)


def lines(controller, outcomes, **more):
    return [
        {
            "controller": controller,
            "episode": k,
            "object": "egg",
            "outcome": outcome,
            "margin_true": 1.5,
            "break_force_N": 2.0,
            "randomized": {},
            "flags": {},
            **more,
        }
        for k, outcome in enumerate(outcomes)
    ]


def test_the_table_agrees_with_the_lines(tmp_path):
    own = lines("adaptive", ["held"] * 8) + lines("touchless", ["held"] * 4 + ["crushed"] * 4)
    result = {
        "level": "synthetic",
        "agreement": {"adaptive": agreement("adaptive", {"weigh": own}, {"weigh": own[:5]})},
        "episodes": 8,
        "tasks": dict.fromkeys(TASKS, summarise(own)),
        "together": together(dict.fromkeys(TASKS, own)),
        "harsh": {"weigh": summarise(own[:8]), "pour": summarise(own[:1])},
        "weighed": {"objects": 0},
    }
    text = table(result)
    # Wilson's interval of 8 of 8 is 67.6 to 100 %
    assert "| pour | 8 of 8 (68-100 %) | 4 of 8 (22-78 %) | +50 (" in text
    assert "| weigh, `harsh` | 8 of 8 (68-100 %) |  |  |" in text
    assert "pour, `harsh`" not in text  # one episode
    assert "| all 6 | 48 of 48 (93-100 %) | 24 of 48 (36-64 %) | +50 (" in text
    assert "| grip force relative to required force, all tasks, median | 1.5 | 1.5 |" in text
    assert "| pour | 0/0/0/0; 1.5 | 4/0/0/0; 1.5 |" in text
    assert text.startswith("Level `synthetic`: ")
    # Wilson's interval of 5 of 5 is 56.6 to 100 %
    assert "| adaptive | 5 of 5 (57-100 %) | 5 / 5 | 1.5 / 1.5 |" in text
    plot(result, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_levels_are_compared_over_the_episodes_that_ended_at_both():
    full = {"weigh": lines("adaptive", ["held", "held", "dropped", "error"])}
    cheap = {
        "weigh": lines("adaptive", ["held", "crushed", "dropped", "held", "held"]),
        "pour": lines("adaptive", ["held"]),  # not run on the mesh
    }
    found = agreement("adaptive", full, cheap)
    assert (found["episodes"], found["alike"], found["held"]) == (3, 2, [2, 1])
    assert agreement("gentle", full, cheap)["episodes"] == 0


def test_a_level_lists_its_omissions_and_is_a_separate_suite(tmp_path):
    known = {level: suite_of(level) for level in ("mesh", "quasistatic", "synthetic")}
    assert {item.effects for item in known.values()} == {
        "-images",
        "-mesh,-images",
        "-mesh,-pipeline",
    }
    assert len({item.name for item in known.values()}) == 3
    with pytest.raises(InputError, match=r"'fine' is unknown .valid: mesh, quasistatic, synthetic"):
        run(tmp_path, level="fine")
    with pytest.raises(InputError, match="'nobody' is unknown"):
        run(tmp_path, parts=("nobody",))


def test_weights_are_compared_with_the_requirement():
    known = [
        line | {"weighed_g": reported, "mass_g_true": true}
        for line, (reported, true) in zip(
            lines("adaptive", ["held"] * 4), [(104, 100), (46, 50), (7, 5), (52, 50)], strict=True
        )
    ]
    found = weighed([*known, *lines("gentle", ["held"])])
    assert found["objects"] == 3  # 5 g are too little to count
    assert found["mean_g"] == pytest.approx((4 - 4 + 2) / 3)
    # 4 % of 100 g and 1 g are 5 g, of 50 g 3 g
    requested = [4 / 5, 4 / 3, 2 / 3]
    assert found["over_asked"] == pytest.approx(np.sqrt(np.mean(np.square(requested))))
    assert weighed([])["objects"] == 0


@pytest.mark.parametrize(("follows", "counts"), [(1.0, True), (0.0, False)])
def test_a_slip_event_counts_unless_the_shear_remains(follows, counts):
    """A grip of 0.8 N that is changed by 5 % at 4 Hz, "slipping" all the while: of force, and of a
    torque alone."""
    for torque in (False, True):
        touches = []
        for time in np.arange(20) / 30:
            wobble = 0.05 * np.sin(2 * np.pi * 4 * time)
            drag = 0.4 * (1 + follows * wobble)
            wrench = np.zeros(6)
            wrench[5 if torque else 1] = 3e-3 * drag if torque else drag
            force = 0.8 * (1 + wobble)
            wrench[2] = -force
            traction = Traction(GRID, GRID, np.zeros((3, 3, 3)), wrench, np.eye(6), 1e3, "made up")
            slip = Slip("slipping", np.zeros(2), 0.0, 0.0)
            touch = Touch(0.0, 0.01, force, 0.003, True, traction=traction, slip=slip)
            touches.append(SimpleNamespace(time=time, touch=touch))
        vetoes = active_slip_test.vetoes(touches)
        assert not vetoes[5]  # no result of the test yet: the sign alone
        assert vetoes[-1] != counts
