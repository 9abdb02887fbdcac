"""Tests of misuse of a session: a closed session or an object other than a controller raises one
named error before any motion."""

import pytest

import mjtactile

SCENARIO = mjtactile.Scenario(effects="-mesh,-pipeline")


@pytest.mark.parametrize("controller", [None, lambda observation: observation.command, "gentle"])
def test_only_controllers_are_accepted(controller):
    with mjtactile.open_session(SCENARIO) as session:
        session.take_references()
        with pytest.raises(mjtactile.InputError, match=r"is not a controller .*load_controller"):
            session.run(controller, time_limit=1.0)


def test_a_closed_session_refuses_calls():
    with mjtactile.open_session(SCENARIO) as session:
        pass
    controller = mjtactile.load_controller("gentle")
    for misuse in (
        session.take_references,
        lambda: session.run(controller, time_limit=1.0),
        lambda: session.steps().__enter__(),
    ):
        with pytest.raises(mjtactile.InputError, match="Session: is closed"):
            misuse()


def test_unknown_field_names_are_refused():
    with pytest.raises(mjtactile.InputError, match="given: 'objekt' is not a field"):
        mjtactile.resolve_scenario(SCENARIO, ("objekt",))
