"""Intervals against scipy's and by counting, and what becomes of errors."""

import numpy as np
import pytest
from scipy.stats import binomtest

from mjtactile.evaluate.statistics import paired, summarise, table
from mjtactile.evaluate.wilson import wilson


@pytest.mark.parametrize(("count", "of"), [(0, 10), (10, 10), (7, 10), (395, 400), (1, 3)])
def test_wilson(count, of):
    theirs = binomtest(count, of).proportion_ci(method="wilson")
    np.testing.assert_allclose(wilson(count, of), (theirs.low, theirs.high), atol=1e-9)


def test_ten_of_ten_is_not_certain():
    assert wilson(10, 10)[0] == pytest.approx(0.7225, abs=1e-4)  # 1 / (1 + z^2 / 10)
    assert wilson(0, 0) == (0.0, 1.0)


def lines(outcomes, name="a"):
    return [
        {
            "episode": k,
            "controller": name,
            "object": "egg",
            "outcome": outcome,
            "slip_mm_true": 0.1 * k,
            "peak_force_true_N": 1.0 + 0.1 * k,
            "break_force_N": 2.6,
        }
        for k, outcome in enumerate(outcomes)
    ]


def test_the_interval_of_a_paired_difference_covers_the_truth():
    """Of 2000 pairs of runs of 60 episodes, success 0.8 and 0.9 and alike in half of all: 95 +- 1.5
    % (3 sd of the count)."""
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(2000):
        luck, first, second = rng.random((3, 60))
        alike = rng.random(60) < 0.5
        held = np.where(alike, luck, first) < 0.8, np.where(alike, luck, second) < 0.9
        low, high = paired(*(lines(np.where(one, "held", "dropped")) for one in held))[
            "difference_interval"
        ]
        inside += low < 0.1 < high
    assert 0.93 < inside / 2000 < 0.98


def test_how_many_episodes_would_settle_it():
    first = lines(["held"] * 50 + ["dropped"] * 10)
    second = lines(["held"] * 55 + ["dropped"] * 5)
    found = paired(first, second)
    assert (
        found["difference"] == pytest.approx(5 / 60)
        and found["only_second"] == 5
        and found["only_first"] == 0
    )
    more = found["episodes_to_settle"]
    assert more == 0  # all five went one way: (z^2 (5/60 - 25/3600)) / (25/3600) = 42 episodes do
    other = paired(
        lines(["held", "dropped"] * 30), lines(["dropped", "held"] * 29 + ["held", "held"])
    )
    assert (
        other["only_first"] == 29
        and other["only_second"] == 30
        and other["episodes_to_settle"] > 10_000
    )
    assert paired(first, first)["episodes_to_settle"] is None


def test_errors_count_apart():
    summary = summarise(
        lines(["held", "error", "dropped", "crushed"])
        + lines(["held", "held", "error", "held"], "b")
    )
    a = summary["controllers"]["a"]
    b = summary["controllers"]["b"]
    assert (a["held"], a["dropped"], a["crushed"], a["error"]) == (1, 1, 1, 1) and a[
        "success"
    ] == pytest.approx(1 / 3)
    assert b["success"] == 1.0 and a["peak_share_of_breaking"]["most"] == 0.5
    assert a["peak_N"]["median"] == pytest.approx(1.15) and a["hold_N"]["median"] is None
    (pair,) = summary["paired"]
    # an error of either leaves the episode out
    assert pair["episodes"] == 2 and pair["only_second"] == 1
    text = table(summary)
    assert "| a | all | 1 of 3 | 6.1-79.2 % | 1 | 1 | 1 | 1.15 (1.30) |  |" in text
    assert "b holds +50.0 % of 2 episodes more often than a" in text
