"""Tests of the cost of viewing, computed from the records of session and page; without a browser
the message gives instructions."""

import pytest

from benchmarks.studio import run
from mjtactile.core.errors import InputError

ROUND = {
    "without": 1.0,
    "factor": 0.9,
    "ratio": 0.9,
    "spent_ms": 0.2,
    "late_ms": 70.0,
    "late_90_ms": 110.0,
    "pictures": 60,
    "load": 2.0,
    "core_s": 2.5,
    "core_without_s": 1.5,
}


def test_latency_ends_when_the_page_first_has_the_image():
    taken = [100.0 + 0.1 * k for k in range(8)]
    # waited for the page; a repeated image; an unknown image
    observed = [(0, 190.0), (4, 100.45), (4, 100.9), (6, 100.67), (7, 100.8), (300, 101.0)]
    found = run.ages(taken, observed)
    assert found["pictures"] == 3
    assert found["late_ms"] == pytest.approx(70) and found["late_90_ms"] == pytest.approx(70)
    with pytest.raises(InputError, match="no image"):
        run.ages(taken, [(0, 190.0)])


def test_the_table_has_medians_and_requirements():
    text = run.table(
        {"rounds": [ROUND, {**ROUND, "ratio": 0.5}, {**ROUND, "ratio": 0.95}], "processors": 2}
    )
    assert "| at least 0.7 | 0.9 | 0.90 |" in text
    assert (
        "| 2.50, 1.50 |" in text
        and "| 70 (110) |" in text
        and "Medians of 3" in text
        and "load average 2.0" in text
    )
    assert len({line.count("|") for line in text.split("\n\n")[0].splitlines()}) == 1


def test_a_missing_browser_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "CHROMIUM", None)
    with pytest.raises(InputError, match="apt-get install chromium"):
        run.run(tmp_path, quick=True, notify=lambda _: None)


def test_grasps_alone_and_watched_are_compared(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "CHROMIUM", "there")
    alone = {"factor": 1.0, "core_s": 1.5}
    monkeypatch.setattr(
        run, "_probe", lambda kind: alone if kind == "plain" else {**ROUND, "factor": 0.8}
    )
    result = run.run(tmp_path, quick=True, notify=lambda _: None)
    assert [item["ratio"] for item in result["rounds"]] == [0.8]
