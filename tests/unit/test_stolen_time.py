"""Tests of the result of a timing test on a computer whose processors are withheld."""

import itertools

import pytest

from tests import stolen

TESTS = """
import pytest

tries = []

@pytest.mark.clock
def test_passes():
    pass

@pytest.mark.clock
def test_fails_once():
    tries.append(1)
    assert len(tries) > 1

@pytest.mark.clock
def test_fails():
    tries.append(1)
    assert 0, "too late"

def test_without_a_clock():
    assert 0
"""


@pytest.fixture
def outcomes(pytester, monkeypatch):
    def run(stolen_each_time):
        clock = itertools.count(0, stolen_each_time)
        monkeypatch.setattr(stolen, "stolen_seconds", lambda: next(clock))
        pytester.makeini("[pytest]\nmarkers = clock")
        pytester.makepyfile(TESTS)
        return pytester.runpytest_inprocess(
            "-p", "tests.stolen", "-p", "no:cacheprovider", "-p", "no:xdist"
        )

    return run


def test_failures_during_stolen_time_are_undecided_and_reported(outcomes):
    result = outcomes(1e3)  # stolen time per attempt, s
    result.assert_outcomes(passed=2, skipped=1, failed=1)  # test_fails_once at its second try
    result.stdout.fnmatch_lines(
        ["UNDECIDED *test_fails: undecided, * taken away: AssertionError: too late*"]
    )


def test_too_many_undecided_are_a_failure(pytester, monkeypatch):
    monkeypatch.setattr(stolen, "stolen_seconds", itertools.count(0, 1e3).__next__)
    pytester.makeini("[pytest]\nmarkers = clock")
    for count, code in ((stolen.UNDECIDED_MAX, 0), (stolen.UNDECIDED_MAX + 1, 1)):
        pytester.makepyfile(
            f"import pytest\n@pytest.mark.clock\n@pytest.mark.parametrize('k', range({count}))\n"
            "def test_fails(k):\n    assert 0\n"
        )
        result = pytester.runpytest_inprocess(
            "-p", "tests.stolen", "-p", "no:cacheprovider", "-p", "no:xdist"
        )
        result.assert_outcomes(skipped=count)
        assert result.ret == code


def test_without_stolen_time_a_failure_counts(outcomes):
    outcomes(0).assert_outcomes(passed=1, failed=3)
