"""Fixtures and helpers of the contract tests."""

import pytest

from mjtactile.emulator.process import EmulatorProcess
from tests.patient import SLOW_CAMERA_DESIGN, patient_rig_file


@pytest.fixture(scope="module")
def emulator():
    """Provide emulated hardware with an egg and long time-outs, one for each test file."""
    process = EmulatorProcess(patient_rig_file(), SLOW_CAMERA_DESIGN, object_name="egg", seed=0)
    yield process
    process.close()
