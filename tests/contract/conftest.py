"""Fixtures and helpers of the contract tests."""

import pytest

from mjtactile.core import scaled_clock
from mjtactile.emulator.process import EmulatorProcess
from tests.emulated import at_pace
from tests.patient import DESIGN, patient_rig_file


@pytest.fixture(scope="module")
def half_speed():
    """Emulated devices at half the speed of other tests: for grasps with cameras, which keep two
    processors busy."""
    with at_pace(2 * scaled_clock.slow()):
        yield


@pytest.fixture(scope="module")
def emulator(half_speed):
    """Patient emulated hardware with an egg, of a test file's own."""
    process = EmulatorProcess(patient_rig_file(), DESIGN, object_name="egg", seed=0)
    yield process
    process.close()
