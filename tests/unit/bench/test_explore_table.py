"""Tests of the number of touches to an accurate surface."""

import pytest

from benchmarks.explore import touches_to


@pytest.mark.parametrize(
    ("errors", "count"),
    [
        ([2.0, 0.5, 0.8, 0.6], 4),  # the third touch made it worse again
        ([None, 0.7, 0.1], 2),  # the first touch missed
        ([0.2], 1),
        ([3.0, 2.0], 3),  # not reached
    ],
)
def test_the_surface_must_stay_accurate(errors, count):
    assert touches_to(errors, 0.7) == count
