"""Tests of the classes of slip detection: in time, late, early or false."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.scenes.slip_cases import FRICTION, HOLDS, OBJECTS, SLIPS, sample_slip_case
from benchmarks.slip.score import Frame, outcome

RATE = 30.0


def frames(speed, detected_at, used=0.5, slides=True):
    """Return one second of hold at the utilization `used`, then one second of sliding at `speed`,
    m/s; "slipping" from `detected_at` on."""
    result = []
    for time in np.arange(60) / RATE:
        slid = max(speed * (time - 1.0), 0.0) if slides else 0.0
        result.append(
            Frame(
                time,
                "slipping" if time >= detected_at else "sticking",
                1.0 if slid > 0 else used,
                slid,
                1.0 if slid > 0 else np.nan,
            )
        )
    return result


@pytest.mark.parametrize(
    ("speed", "detected_at", "name"),
    [
        (2e-3, 1.09, "in time"),
        (2e-3, 1.19, "before 0.5 mm"),
        (20e-3, 1.09, "within 100 ms"),
        (20e-3, 1.19, "late"),
        (2e-3, 9.0, "missed"),
        (2e-3, 0.79, "early"),
        (2e-3, 0.91, "in time"),
    ],
)
def test_slips_are_classified(speed, detected_at, name):
    found = outcome(frames(speed, detected_at))
    assert found.name == name
    assert found.speed == pytest.approx(speed, rel=0.2)  # an image after 0.5 mm


def test_a_detection_near_the_limit_is_not_early():
    assert outcome(frames(2e-3, 0.5, used=0.9)).name == "in time"


def test_holds_and_undecided_cases():
    assert outcome(frames(0.0, 9.0, slides=False)).name == "quiet"
    assert outcome(frames(0.0, 0.5, slides=False)).name == "false"
    assert outcome(frames(0.0, 0.5, used=0.9, slides=False)).name == "between"
    assert outcome(frames(0.2e-3, 0.5)).name == "between"  # it slides by 0.2 mm


def test_cases_are_sampled_from_their_seed_and_cover_all_ways():
    cases = [sample_slip_case(seed) for seed in range(40)]
    assert {case.name for case in cases} == {*SLIPS, *HOLDS} and cases[3] == sample_slip_case(3)
    assert {case.body for case in cases} <= set(OBJECTS)
    assert all(FRICTION[0] <= mu <= FRICTION[1] for case in cases for mu in case.friction)
    one = next(case for case in cases if case.name == "one of two")
    assert one.friction[0] < one.friction[1]
