"""What the contract tests share."""

import pytest

from mjtactile.core import pace
from tests.emulated import at_pace


@pytest.fixture(scope="module")
def half_speed():
    """Emulated devices at half the speed of other tests: for grasps with cameras, which keep two
    processors busy."""
    with at_pace(2 * pace.slow()):
        yield
