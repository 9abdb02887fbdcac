"""Tests of the operating curve of slip detection: counting, and order of its points."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.slip import operating_curve
from benchmarks.slip.operating_curve import SCALES, alarms, curve, scaled
from benchmarks.slip.score import Frame
from mjtactile.sensing.settings import DEFAULTS

RATE = 30.0
SECONDS = 2.0


def frames(onset):
    """Return two seconds that hold, and from `onset` on slide at 4 mm/s (NaN: never)."""
    result = []
    for time in np.arange(int(SECONDS * RATE)) / RATE:
        slides = time >= onset
        slid = 4e-3 * (time - onset) if slides else 0.0
        result.append(Frame(time, "", 1.0 if slides else 0.5, slid, onset if slides else np.nan))
    return result


def signs(frames, *times):
    """Return signs of each scale, where the k-th scale reports slip for two images from `times[k]`,
    s."""
    one = [[at <= f.time + 1e-9 < at + 1.5 / RATE for at in times] for f in frames]
    return [[*row, *[False] * (len(SCALES) - len(row))] for row in one]


def test_alarms_are_counted_once_for_successive_images():
    hold = frames(np.nan)
    found = alarms(hold, signs(hold, 0.5, 1.0))
    assert [item.alarms for item in found[:3]] == [1, 1, 0]
    assert [item.outcome for item in found[:3]] == ["false", "false", "quiet"]


def test_a_point_of_the_curve_by_hand():
    hold, slip = frames(np.nan), frames(1.0)
    # scale 1: in the hold, and in time; scale 2: after 0.2 s; the others: never
    rows = [
        {"seconds": SECONDS, "scales": [vars(alarm) for alarm in alarms(hold, signs(hold, 0.5))]},
        {
            "seconds": SECONDS,
            "scales": [vars(alarm) for alarm in alarms(slip, signs(slip, 1.05, 1.2))],
        },
    ]
    points = curve(rows)
    assert [point["in_time"] for point in points[:3]] == [1.0, 0.0, 0.0]
    assert points[0]["per_minute"] == pytest.approx(60 / SECONDS)
    assert points[0]["holds_alarmed"] == 1.0
    assert points[1]["per_minute"] == 0.0
    assert [point["in_time"] for point in curve(rows, limit=0.4)[:3]] == [1.0, 1.0, 0.0]


def test_scale_one_is_the_detector_of_the_pipeline():
    assert 1.0 in operating_curve.SCALES
    assert scaled(DEFAULTS.slip, 1.0) == DEFAULTS.slip


def test_a_larger_scale_requires_more():
    strict = scaled(DEFAULTS.slip, 2.0)
    assert strict.evidence == 2 * DEFAULTS.slip.evidence
    assert strict.even < DEFAULTS.slip.even
