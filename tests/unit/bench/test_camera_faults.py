"""Tests that the table of camera faults counts unreported errors only."""

from types import SimpleNamespace

import pytest

from benchmarks.camera_faults.error_statistics import numbers
from benchmarks.camera_faults.fault_kinds import ALWAYS, REFERENCES, RUN, TABLES, kinds
from benchmarks.camera_faults.replay import ReplayResult
from benchmarks.camera_faults.run import _sums, table
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import Touch


def touch(force, sd, status=OK):
    return Touch(0.0, 0.0, force, sd, False, status=status)


def test_far_is_beyond_five_sd_and_a_twentieth_of_a_newton():
    lost = Status(StatusCode.FIT_FAILED)
    touches = (touch(1.0, 0.01), touch(1.06, 0.01), touch(1.04, 0.001), touch(1.3, 0.1))
    grasp = SimpleNamespace(images=[0] * 5, true=[1.0] * 5)
    found = numbers(grasp, ReplayResult((*touches, touch(9.0, 0.01, lost))))
    assert (found["images"], found["ok"], found["far"]) == (5, 4, 1)
    assert found["worst_N"] == pytest.approx(0.3)
    assert found["status"] == {"fit failed": 1, "ok": 4}
    row = {"sensor": "dense", "name": "x", "when": RUN, "strength": {"gamma": 1.3}, **found}
    row["without"] = found
    shown = table({"rows": [row], "sums": _sums([row]), "air": []})
    assert "(25.00 %)" in shown and "without pressure sensor 1 of 4" in shown
    cells = next(line for line in shown.splitlines() if "gamma 1.3" in line).split(" | ")
    assert cells[1] == "" and cells[2].endswith("; 1 far (0.010); 1 fit failed")
    assert cells[4].endswith(" / 0.30; 1 far")
    good = numbers(grasp, ReplayResult((touch(1.02, 0.01),) * 5))
    rows = [row, {**row, "name": "y", **good, "without": good}]
    lines = table({"rows": rows, "sums": _sums(rows), "air": []}).splitlines()
    # a fault without effect has no separate row
    assert lines[-1] == "| y | 0.020 / 0.02 | 0.020 / 0.02 |"


def test_fault_strengths_match_their_levels_and_are_reproducible():
    found = list(kinds(5))
    assert found == list(kinds(5)) and found != list(kinds(6))
    assert {kind.when for kind in found} == {ALWAYS, RUN, REFERENCES}
    asked = {name: requested for name, requested, _ in TABLES}
    for kind in found:
        zoom = kind.table.get("scale_percent")
        if zoom is not None:
            assert 0.8 <= zoom / asked[kind.name]["scale_percent"] <= 1.2
        gamma = kind.table.get("gamma", 1.0)
        if gamma != 1.0:
            assert 0.8 <= (gamma - 1) / (asked[kind.name]["gamma"] - 1) <= 1.2
        assert kind.faults  # within the fields' ranges
