"""Fixtures of the driver tests."""

import pytest

from tests.emulated import servo_bench


@pytest.fixture
def bench():
    """Two emulated servos on a bus of their own."""
    with servo_bench() as bench:
        yield bench
