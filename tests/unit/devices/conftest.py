"""Fixtures of the driver tests."""

import pytest

from tests.emulated import servo_bench


@pytest.fixture
def bench():
    """Provide two emulated servos on a separate bus."""
    with servo_bench() as bench:
        yield bench
