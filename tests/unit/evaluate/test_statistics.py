"""Tests of intervals against scipy's and by counting, and of the treatment of errors."""

import numpy as np
import pytest
from scipy.stats import binomtest, multinomial

from mjtactile.evaluate.statistics import paired, paired_interval, summarise, table
from mjtactile.evaluate.wilson import wilson


@pytest.mark.parametrize(("count", "of"), [(0, 10), (10, 10), (7, 10), (395, 400), (1, 3)])
def test_wilson(count, of):
    reference = binomtest(count, of).proportion_ci(method="wilson")
    np.testing.assert_allclose(wilson(count, of), (reference.low, reference.high), atol=1e-9)


def test_ten_of_ten_successes_have_an_interval():
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


@pytest.mark.parametrize("n", [8, 24, 60])
def test_the_interval_of_a_paired_difference_covers_the_truth(n):
    """Computed over all results of n pairs: coverage of the true difference is at least 94 % for
    any fractions. (Agresti and Min's covers down to 86 % where few differ.)"""
    results = [(b, c) for b in range(n + 1) for c in range(n + 1 - b)]
    low, high = np.array([paired_interval(b, c, n) for b, c in results]).T
    b, c = np.array(results).T
    for only_first in (0.002, 0.03, 0.1, 0.3):
        for only_second in (0.004, 0.05, 0.2, 0.6):
            alike = 1 - only_first - only_second
            chance = multinomial.pmf(
                np.stack([b, c, n - b - c], axis=1), n, [only_first, only_second, alike]
            )
            truth = only_second - only_first
            assert chance[(low <= truth) & (truth <= high)].sum() > 0.94


def test_without_differing_episodes_the_interval_is_not_zero():
    # of 24 equal pairs, each fraction is below 1 - 0.025^(1 / 24) = 14.2 %: Clopper and Pearson
    low, high = paired_interval(0, 0, 24)
    assert high == pytest.approx(1 - 0.025 ** (1 / 24)) and low == -high
    # one side alone is theirs
    assert paired_interval(0, 24, 24)[1] == 1.0 and paired_interval(24, 0, 24)[0] == -1.0
    assert paired_interval(0, 0, 0) == (-1.0, 1.0)


def test_required_episodes_are_estimated():
    first = lines(["held"] * 50 + ["dropped"] * 10)
    second = lines(["dropped"] * 2 + ["held"] * 54 + ["dropped"] * 4)
    found = paired(first, second)
    assert (found["only_second"], found["only_first"], found["alike"]) == (6, 2, 52)
    more = found["episodes_to_settle"]
    n = 60 + more

    def low(n):
        return paired_interval(2 * n / 60, 6 * n / 60, n)[0]

    # with as many of each kind in them, so many settle it, and one fewer does not
    assert low(n) > 0 >= low(n - 1)
    # both kinds differ significantly if 6 of 60 differ in one direction and none in the other
    assert paired(first, lines(["held"] * 56 + ["dropped"] * 4))["episodes_to_settle"] == 0
    other = paired(
        lines(["held", "dropped"] * 30), lines(["dropped", "held"] * 29 + ["held", "held"])
    )
    assert (other["only_first"], other["only_second"]) == (29, 30)
    assert other["episodes_to_settle"] > 10_000
    assert paired(first, first)["episodes_to_settle"] is None


def test_fewer_than_five_differing_episodes_are_not_extrapolated():
    """One differing episode may be 0.1 or 15 % of all: too few for a prediction."""
    first = lines(["held"] * 20)
    for differing in (1, 4):
        second = lines(["dropped"] * differing + ["held"] * (20 - differing), "b")
        summary = summarise(first + second)
        assert summary["paired"][0]["episodes_to_settle"] is None
        assert f"undecided; {differing} episode" in (text := table(summary))
        assert "more episodes like these" not in text
    first, second = lines(["held"] * 19 + ["dropped"]), lines(["dropped"] * 4 + ["held"] * 16)
    assert paired(first, second)["episodes_to_settle"] > 0


def test_several_controllers_are_compared_with_a_named_adjustment():
    """6 of 60 settle one comparison; among three, each has a third of the 5 % (Bonferroni)."""
    a = lines(["held"] * 50 + ["dropped"] * 10)
    b = lines(["held"] * 56 + ["dropped"] * 4, "b")
    c = lines(["held"] * 50 + ["dropped"] * 10, "c")
    assert "(95 %: " in table(summarise(a + b)) and "settled" in table(summarise(a + b))
    summary = summarise(a + b + c)
    first = summary["paired"][0]
    assert first["comparisons"] == 3 and first["adjustment"] == "Bonferroni"
    assert first["adjusted_interval"] == list(paired_interval(0, 6, 60, 0.05 / 3))
    assert first["difference_interval"] == list(paired_interval(0, 6, 60))
    assert first["adjusted_interval"][0] < 0 < first["difference_interval"][0]
    text = table(summary)
    assert "(95 % for all 3 comparisons together, Bonferroni: " in text and ": settled" not in text


def test_errors_are_counted_separately():
    summary = summarise(
        lines(["held", "error", "dropped", "crushed"])
        + lines(["held", "held", "error", "held"], "b")
    )
    a = summary["controllers"]["a"]
    b = summary["controllers"]["b"]
    assert (a["held"], a["dropped"], a["crushed"], a["error"]) == (1, 1, 1, 1) and a[
        "success"
    ] == pytest.approx(1 / 3)
    assert b["success"] == 1.0 and a["peak_to_break_ratio"]["max"] == 0.5
    assert a["peak_N"]["median"] == pytest.approx(1.15) and a["hold_N"]["median"] is None
    (pair,) = summary["paired"]
    # an error of either leaves the episode out
    assert pair["episodes"] == 2 and pair["only_second"] == 1
    text = table(summary)
    assert "| a | all | 1 of 3 | 6.1-79.2 % | 1 | 1 | 0 | 1 | 1.15 (1.30) |  |  |" in text
    assert "b holds 50.0 points more than a in the same 2 episodes" in text
    assert "1 with the same outcome): " in text


def test_a_blocked_failed_or_stopped_controller_counts_as_a_failure():
    summary = summarise(lines(["held", "hung", "raised", "unsafe", "hung", "error"]))
    a = summary["controllers"]["a"]
    assert a["success"] == pytest.approx(1 / 5) and a["hung"] == 2
    assert "| a | all | 1 of 5 |" in (text := table(summary))
    assert "| 4 (1 unsafe, 2 hung, 1 raised) | 1 |" in text


def test_outcomes_are_counted_with_and_without_each_flag():
    """Six episodes by hand: the three with an edge hold twice, the three without once."""
    some = lines(["held", "held", "dropped", "held", "dropped", "error"])
    for line in some[:3]:
        line["flags"] = {"sharp_edge": "an edge presses"}
    some[1]["flags"] |= {"frame_contact": "the frame carries 3.0 N"}
    found = summarise(some)
    edge = found["controllers"]["a"]["flags"]["sharp_edge"]
    assert (edge["with"]["held"], edge["with"]["dropped"], edge["with"]["episodes"]) == (2, 1, 3)
    assert (edge["without"]["held"], edge["without"]["error"]) == (1, 1)
    assert edge["without"]["success"] == 0.5  # an error counts apart
    assert (
        "3 of 6 episodes have flags of reduced simulation accuracy (frame_contact 1, sharp_edge 3)"
        in table(found)
    )
    assert summarise(lines(["held"]))["controllers"]["a"]["flags"] == {}
