"""Tests of the pruned stability matrix, and of rejections and flags at the method's limits."""

from dataclasses import replace

import pytest

from benchmarks.scenes.stress_scenes import DropWorld, FreeObject
from benchmarks.stability import run
from benchmarks.stability.cases import matrix, pruned
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor import validity_checks


def test_the_matrix_is_large_and_its_cases_are_distinct():
    cases = matrix()
    assert len(cases) >= 300
    assert len({(case.axis, case.label) for case in cases}) == len(cases)


@pytest.mark.slow
@pytest.mark.parametrize("case", pruned(), ids=lambda case: f"{case.axis}: {case.label}")
def test_a_pruned_case_is_ok_flagged_or_refused(case):
    row = run.evaluate(case)
    assert row["outcome"] in ("ok", "flagged", "refused"), row["reason"]


def test_a_normal_press_is_ok():
    case = next(c for c in matrix() if (c.axis, c.label) == ("time step", "4 ms"))
    assert run.evaluate(case)["outcome"] == "ok"


@pytest.mark.parametrize(("problem", "words"), [("force", "quarter"), ("settled", "settle")])
def test_the_score_fails_unexplained_errors(monkeypatch, problem, words):
    case = next(c for c in matrix() if (c.axis, c.label) == ("time step", "8 ms"))

    def measure(case):
        wrong = case.timestep < 8e-3 and problem == "force"
        return {
            "force_N": 0.5 if wrong else 0.3,
            "flags": {"stretch": "large"},
            "problems": {} if problem == "force" else {"settled": "does not settle"},
        }

    monkeypatch.setattr(run, "measure", measure)
    row = run.evaluate(case)
    assert row["outcome"] == "FAILED" and words in row["reason"]


def design(**rubber):
    base = load_sensor("paper16")
    return replace(base, membrane=replace(base.membrane, **rubber))


@pytest.mark.parametrize(
    ("rubber", "words"),
    [
        ({"thickness": 4e-3}, "thickness_mm.*plate.*at most 3"),
        ({"pre_stretch": 0.9}, r"pre_stretch.*slack.*at least 0\.95"),
    ],
)
def test_sheets_that_cannot_be_membranes_are_refused(rubber, words):
    with pytest.raises(InputError, match=words):
        PressWorld(design(**rubber), Indenter.parse("sphere:8"))


def test_a_slack_membrane_is_flagged_for_wrinkles():
    world = PressWorld(design(pre_stretch=0.98), Indenter.parse("sphere:8"))
    world.inflate(0.0, seal=False)
    assert "compression" in world.flags["wrinkles"]


def test_a_thick_membrane_and_a_coarse_mesh_are_flagged():
    assert "bending" in validity_checks.design_flags(
        design(thickness=2e-3, pre_stretch=1.0), 13, 11
    )
    assert "(13, 11)" in validity_checks.design_flags(design(), 7, 7)["mesh"]
    assert not validity_checks.design_flags(design(), 13, 11)


def test_a_body_that_passes_the_membrane_stops_the_run():
    """A sheet of paper at 30 m/s moves by 600 times its thickness in a step, so that no contact is
    detected."""
    world = DropWorld(
        "paper16", FreeObject("plate", 2e-4, 1e-3), gauge_pressure=1000.0, speed=30.0, guided=True
    )
    with pytest.raises(SimulationError, match=r"went through|glass|sunk"):
        world.step(300)


def test_a_body_too_fast_for_the_time_step_is_flagged():
    world = DropWorld(
        "paper16",
        FreeObject("sphere", 3e-3, 0.05),
        gauge_pressure=1000.0,
        speed=2.0,
        timestep=4e-3,
        guided=True,
    )
    world.step()  # at release; the membrane stops it long before a check every 20 ms
    assert "use a timestep of at most" in world.flags["speed"]


def test_an_interrupted_run_keeps_its_finished_cases(tmp_path):
    log = tmp_path / "stability.jsonl"
    log.write_text(
        '{"axis": "mesh", "label": "7x7, 1 ms", "outcome": "ok"}\n{"axis": "gone", "label": '
        '"x"}\n{"axis": "me'
    )
    place = {(case.axis, case.label): i for i, case in enumerate(matrix())}
    assert [row["outcome"] for row in run._kept(log, place)] == ["ok"]
    assert not run._kept(tmp_path / "none.jsonl", place)


def test_the_gas_is_implicit_in_every_step():
    """The gas is implicit in every step, and no step adds energy.

    MuJoCo leaves out the stiffness of a tendon at exactly its rest length. Over a shallow chamber
    the gas was then occasionally explicit for a step. This struck the membrane (2e-4 J) until it
    reached the glass.
    """
    design = load_sensor("paper16")
    world = PressWorld(
        replace(design, chamber=replace(design.chamber, depth=1e-3)),
        Indenter.parse("sphere:8"),
        mesh=(11, 9),
    )
    world.inflate(1000.0, seal=True)
    world.press(0.7e-3)
    energies = []
    for _ in range(300):
        world.step()
        energies.append(world.kinetic_energy)
    # J: a membrane of 0.3 g at 1 mm/s; measured: a hundredth of that
    assert max(energies) < 1e-10
