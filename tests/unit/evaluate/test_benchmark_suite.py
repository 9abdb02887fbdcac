"""Tests of a suite of tasks: its results belong to these files and this scorer, and compared
results have the same episodes."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.evaluate import benchmark_suite, store
from mjtactile.evaluate.statistics import paired
from mjtactile.runtime.task_scoring import VERSION

MINE = "mine"
OTHER = "other"


@pytest.fixture
def new():
    return benchmark_suite.new_suite("mine", ("pour", "shake"), objects=("egg",), seed=7, develop=0)


def ran(kind, folder, task, outcomes, **changes):
    """Write a folder of results as an evaluation does; `outcomes` by controller, one word per
    episode."""
    scenario = {
        key: value
        for key, value in kind.scenario(task).to_dict().items()
        if key not in ("object", "controller")
    }
    options = {
        "count": 2,
        "controllers": list(outcomes),
        "objects": list(kind.objects),
        "shard": [1, 1],
        "scenario": scenario | changes,
    }
    files = [resources.find(task, "models/tasks", ".toml")]
    (folder / task).mkdir(parents=True)
    known = json.dumps(store.manifest(options, files))
    (folder / task / store.MANIFEST).write_text(known)
    lines = [
        {
            "controller": name,
            "episode": k,
            "object": "egg",
            "outcome": outcome,
            "margin_true": 1.5 + k,
            "break_force_N": 2.0,
            "peak_force_true_N": 1.0,
            "hold_force_true_N": 0.5,
            "randomized": {},
            "flags": {},
        }
        for name, words in outcomes.items()
        for k, outcome in enumerate(words)
    ]
    store.write_lines(folder / task, lines)


def test_compared_controllers_have_the_same_episodes(new, tmp_path):
    arguments = ["held", "crushed", "held", "unsafe", "held"]
    ran(new, tmp_path / "theirs", "pour", {OTHER: arguments})
    ran(new, tmp_path / "theirs", "shake", {OTHER: ["dropped"]})
    table = new.with_results(tmp_path / "theirs")
    table.write(tmp_path / "mine.json")
    known = benchmark_suite.load_suite(tmp_path / "mine.json")
    assert known.results["pour"][OTHER]["outcomes"] == "hchuh"
    assert known.results["pour"][OTHER]["margin"] == 3.5
    assert [line["outcome"] for line in known.lines("pour", OTHER)] == arguments
    ran(new, tmp_path / "own", "pour", {MINE: ["held"] * 4})
    found = benchmark_suite.compare(known, tmp_path / "own")
    assert list(found["tasks"]) == ["pour"]  # the other was not run
    pair = found["tasks"]["pour"][MINE]["against"][OTHER]
    assert pair["episodes"] == 4 and pair["difference"] == 0.5
    own = [{"episode": k, "outcome": "held"} for k in range(4)]
    assert pair == paired(known.lines("pour", OTHER), own)
    assert "| pour | mine | 4 of 4 (51-100 %) | 3.0 | +50 (" in benchmark_suite.table(known, found)
    # the same number of another task is another episode: 3 of 5 are held by the new one alone
    ran(new, tmp_path / "own", "shake", {MINE: ["held"]})
    found = benchmark_suite.compare(known, tmp_path / "own")
    together = found["together"][MINE]
    assert together["episodes"] == together["held"] == together["against"][OTHER]["episodes"] == 5
    assert together["against"][OTHER]["difference"] == pytest.approx(0.6)
    assert "| all 2 | mine | 5 of 5 (57-100 %) | 2.5 | +60 (" in benchmark_suite.table(known, found)


def test_results_of_other_files_or_another_scoring_are_not_compared(new, tmp_path, monkeypatch):
    path = tmp_path / "mine.json"
    replace(new, files={**new.files, "pour.toml": "0" * 64}).write(path)
    with pytest.raises(InputError, match=r"other versions of these files: pour\.toml"):
        benchmark_suite.load_suite(path)
    new.write(path)
    monkeypatch.setattr(benchmark_suite, "VERSION", "99")
    with pytest.raises(
        InputError, match=rf"was scored by version {VERSION}, but this is version 99"
    ):
        benchmark_suite.load_suite(path)
    path.write_text('{"judge": "1"}')
    with pytest.raises(InputError, match="`judge` is now `scoring_version`"):
        benchmark_suite.load_suite(path)
    path.write_text("{}")
    with pytest.raises(InputError, match="is not a suite"):
        benchmark_suite.load_suite(path)


def test_results_of_another_scenario_are_refused(new, tmp_path):
    with pytest.raises(InputError, match="no results of mine"):
        benchmark_suite.compare(new, tmp_path)
    ran(new, tmp_path, "pour", {MINE: ["held"]}, seed=8)
    with pytest.raises(InputError, match="does not belong to task pour of suite mine"):
        benchmark_suite.compare(new, tmp_path)


@pytest.mark.parametrize("name", resources.names(benchmark_suite.FOLDER, ".json"))
def test_shipped_results_match_the_current_files(name):
    known = benchmark_suite.load_suite(name)
    assert known.name == name
    for task in known.tasks:
        assert known.results[task]
        for controller in known.results[task]:
            assert known.lines(task, controller)
            shipped = resources.names("controllers", ".py")
            assert controller in (*shipped, "oracle"), Path(controller)
