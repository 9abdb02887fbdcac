"""Tests of errors that are raised in one process and caught in another."""

import pickle

import pytest

from mjtactile.core.errors import ControllerError, InputError, Interrupted, SimulationError
from mjtactile.devices.dynamixel.servo import ServoFault


@pytest.mark.parametrize(
    "error",
    [
        Interrupted(),
        ServoFault("servo 1 is hot", 1),
        SimulationError("MuJoCo warned: INERTIA", step=3, time=0.1),
        InputError("is unknown", source="a.toml", field="rate", choices=[1, 2]),
        ControllerError("raised", source="mine.py"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_is_pickled_unchanged(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error) and str(again) == str(error) and vars(again) == vars(error)
    assert again.exit_code == error.exit_code
