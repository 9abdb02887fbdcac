"""Tests of benchmark tables: rows of every outcome, and insertion between the markers of a page."""

import importlib.util
import math

import pytest

from benchmarks import grasp
from benchmarks.tasks.simulation_levels import LEVELS
from mjtactile.commands.bench import ARGUMENTS, BENCHMARKS
from mjtactile.commands.output import insert_table, page_of_table
from mjtactile.core.errors import InputError, SimulationError

MILLISECONDS = {
    "rest": 12.0,
    "camera": 5.0,
    "perception": 10.0,
    "controller": 0.1,
    "perception_median": 10.0,
}


class FakeResult:
    milliseconds = MILLISECONDS

    def __init__(self, options):
        self.options = options

    def summary(self):
        return {
            "object": self.options.object,
            "seed": self.options.seed,
            "outcome": "held",
            "hold_force_N": 0.6,
            "hold_force_true_N": 0.62,
            "peak_force_true_N": 0.7,
            "slip_mm_true": 0.1,
            "real_time_factor": 1.0,
        }


def fake_run(scenario, observers):
    if scenario.object == "vial":
        raise SimulationError("diverged", step=7, time=0.1)
    observers[0].add(None, marker_error_true=[2e-5, math.nan])
    return FakeResult(scenario)


def test_a_failed_run_is_a_row_and_never_a_result(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(grasp, "run_grasp", fake_run)
    result = grasp.run(tmp_path, quick=True)
    assert [row["outcome"] for row in result["runs"]] == ["held", "held", "fault"]
    assert result["objects"]["egg"]["hold_force_error_N_mean"] == pytest.approx(-0.02)
    assert result["objects"]["egg"]["marker_error_mm_mean"] == pytest.approx(0.02)
    table = grasp.table(result)
    assert "| egg | 1 of 1 | 0 | 0.62 | -0.020 / -0.020 | 0.70 | 0.10 | 0.020 |" in table
    assert "| vial | 0 of 1 | 0 |" in table and "| egg | 44 % | 18 % | 37 % | 0 % |" in table
    widths = {line.count("|") for line in table.split("\n\n")[0].splitlines()}
    assert len(widths) == 1  # every row has as many cells as the head
    assert "step 7" in capsys.readouterr().err and (tmp_path / "grasp.png").exists()


def test_a_table_replaces_the_text_between_its_markers(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "a\n<!-- bench:grasp -->\nold\n<!-- /bench -->\nb\n<!-- bench:x -->\nkeep\n<!-- /bench "
        "-->\n"
    )
    insert_table(page, "grasp", "new\n")
    assert page.read_text() == (
        "a\n<!-- bench:grasp -->\nnew\n<!-- /bench -->\nb\n<!-- bench:x -->\nkeep\n<!-- /bench "
        "-->\n"
    )
    with pytest.raises(InputError, match="bench:other"):
        insert_table(page, "other", "new")
    with pytest.raises(InputError, match="bench:other"):
        page_of_table("other")


def test_an_interrupted_rig_benchmark_resumes(tmp_path):
    from benchmarks.rig.run import _Store

    calls = []
    store = _Store(tmp_path / "rig.json", resume=False)
    store.once("bus", lambda: {"ms": math.nan})
    store.repeat("killed", 2, lambda n: calls.append(n) or {"n": n})
    again = _Store(tmp_path / "rig.json", resume=True)
    again.once("bus", lambda: pytest.fail("was done"))
    again.repeat("killed", 4, lambda n: calls.append(n) or {"n": n})
    assert calls == [0, 1, 2, 3] and [row["n"] for row in again.result["killed"]] == [0, 1, 2, 3]
    assert again.result["bus"] == {"ms": None}  # unknown values are null in JSON


def test_the_rigs_table_counts_late_and_unsafe_runs():
    from benchmarks.rig import run

    row = {"state": "latched", "outcome": "leak"}
    result = {
        "fault:puncture": [
            {"safe": True, "reaction_s": 0.1} | row,
            {"safe": True, "reaction_s": 0.3} | row,
            {"safe": False, "reaction_s": None} | row,
        ],
        "killed": [
            {
                "kind": "brake",
                "servos_stopped_s": 0.2,
                "valves_vented_s": None,
                "squeeze_before_N": 0.9,
                "squeeze_after_N": after,
                "closed_by_mm": 0.3,
            }
            for after in (0.1, 0.15)
        ],
    }
    table = run.table(result)
    assert "2 of 3, 1 later than 200 ms, worst 300 ms" in table and "valves vented never" in table
    assert "0.90 N before, 0.15 N a second later" in table
    assert "| puncture | 2 of 3 | 200 / 300 |" in table


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_has_its_module(name):
    module = importlib.util.find_spec(f"benchmarks.{BENCHMARKS[name][0]}")
    assert module is not None, f"bench {name}: benchmarks.{BENCHMARKS[name][0]} does not exist"


def test_the_help_names_the_levels_of_the_tasks():
    (level,) = [argument for argument in ARGUMENTS if "--level" in argument.names]
    assert all(name in level.settings["help"] for name in LEVELS)
