"""Fixtures and helpers of the contract tests."""

import pytest

from mjtactile.emulator.process import EmulatorProcess
from tests.patient import SLOWER, patient_rig_file


@pytest.fixture(scope="module")
def emulator():
    """Patient emulated hardware with an egg, of a test file's own."""
    process = EmulatorProcess(patient_rig_file(), SLOWER, object_name="egg", seed=0)
    yield process
    process.close()
