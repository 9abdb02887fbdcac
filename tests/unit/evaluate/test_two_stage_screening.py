"""Tests of cheap screening: many episodes run cheaply, the failures and a sample in full. They
cover the selection of repeated episodes and the conclusions."""

import pytest

from mjtactile.cli import main
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.evaluate import two_stage_screening
from mjtactile.evaluate.pool import Running
from mjtactile.evaluate.statistics import exact_limits
from mjtactile.evaluate.store import read_lines

FAILS_WHEN_CHEAP = {3, 8, 11}
FAILS_IN_FULL = {3, 8, 14}


def synthetic_line(episode):
    """Return a line without a grasp: episodes 3 and 8 fail at both levels, 11 only at the cheap
    level, 14 only in full."""
    cheap = "-pipeline" in episode.scenario.effects
    fails = episode.index in (FAILS_WHEN_CHEAP if cheap else FAILS_IN_FULL)
    return {
        "episode": episode.index,
        "controller": episode.controller,
        "object": "egg",
        "seed": episode.scenario.seed,
        "outcome": "dropped" if fails else "held",
    }


def run(folder, sample, *, resume=False):
    return two_stage_screening.screen(
        folder, Scenario(), sample=sample, controllers=["gentle"], count=20, objects=["egg"],
        running=Running(workers=1, run_one=synthetic_line, resume=resume),
    )  # fmt: skip


def test_all_failures_and_a_sample_are_run_again(tmp_path):
    result = run(tmp_path / "out", 5)["controllers"]["gentle"]
    assert (result["screened_held"], result["screened_failed"]) == (17, 3)
    assert (result["of_failed"]["run_again"], result["of_held"]["run_again"]) == (3, 5)
    again = read_lines(tmp_path / "out/full")
    assert {line["episode"] for line in again} >= FAILS_WHEN_CHEAP and len(again) == 8
    assert result["of_failed"]["differing"] == [
        {"episode": 11, "screened": "dropped", "full": "held"}
    ]
    # existing episodes are not repeated, and the result is the same
    assert run(tmp_path / "out", 5, resume=True)["controllers"]["gentle"] == result


def test_with_all_run_again_the_fraction_is_that_of_full_fidelity(tmp_path):
    result = run(tmp_path / "out", 100)["controllers"]["gentle"]
    assert result["holds_share"] == pytest.approx(17 / 20)
    # one of 17 that were held when screened was not: its exact limits, over all 20
    low, high = exact_limits(16, 17)
    assert result["holds_interval"] == pytest.approx([(1 + 17 * low) / 20, (1 + 17 * high) / 20])
    differ = [
        item["episode"] for key in ("of_failed", "of_held") for item in result[key]["differing"]
    ]
    assert differ == [11, 14]


def test_the_sample_is_random_and_reproducible():
    lines = [{"episode": k, "controller": "gentle", "outcome": "held"} for k in range(300)]
    first = two_stage_screening.to_run_again(lines, 30)
    assert first == two_stage_screening.to_run_again(lines, 30) and len(set(first)) == 30
    assert max(first) > 200 and min(first) < 100  # not the first thirty
    # limits of Clopper and Pearson: none of n leaves 1 - 0.025^(1/n)
    assert exact_limits(0, 30) == pytest.approx((0.0, 1 - 0.025 ** (1 / 30)))


def test_bad_input(tmp_path, capsys):
    with pytest.raises(InputError, match="nothing is left to screen"):
        two_stage_screening.screen(
            tmp_path, Scenario(effects="-mesh"), sample=1, controllers=["gentle"], count=1,
            objects=["egg"],
        )  # fmt: skip
    assert main(["evaluate", "--screening-sample", "3"]) == 2
    assert "--screening-sample N --out DIR" in capsys.readouterr().err
    assert (
        main(["evaluate", "--screening-sample", "3", "--shard", "1/2", "--out", str(tmp_path)]) == 2
    )
    assert "--shard" in capsys.readouterr().err
