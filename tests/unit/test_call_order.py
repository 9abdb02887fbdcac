"""Tests of methods of public classes called out of order: one named error each, or no effect."""

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile import InputError

SCENARIO = mjtactile.Scenario(effects="-mesh,-pipeline")
COMMAND = mjtactile.Command(0.03, 1.0)


@pytest.fixture
def session():
    with mjtactile.open_session(SCENARIO) as opened:
        yield opened


@pytest.fixture
def ready(session):
    session.take_references()
    return session


def gentle():
    return mjtactile.load_controller("gentle")


def send_first(session):
    with session.steps() as steps:
        steps.send(COMMAND)


def send_twice(session):
    with session.steps() as steps:
        steps.observe()
        steps.send(COMMAND)
        steps.send(COMMAND)


def observe_after_close(session):
    with session.steps() as steps:
        steps.observe()
    steps.observe()


def send_after_close(session):
    with session.steps() as steps:
        steps.observe()
    steps.send(COMMAND)


def step_in_steps(session):
    with session.steps(), session.steps():
        pass


def run_in_steps(session):
    with session.steps():
        session.run(gentle(), time_limit=1.0)


def references_in_steps(session):
    with session.steps():
        session.take_references()


def steps_in_run(session):
    session.run(gentle(), time_limit=1.0, on_cycle=lambda _: session.steps().__enter__())


NO_OBSERVATION = r"Session.steps: .* call observe\(\) before each send"
CLOSED = r"Session.steps: is closed"
OUT_OF_ORDER = [
    (send_first, NO_OBSERVATION),
    (send_twice, NO_OBSERVATION),
    (observe_after_close, CLOSED),
    (send_after_close, CLOSED),
    (step_in_steps, "Session: is in use by steps"),
    (run_in_steps, "Session: is in use by steps"),
    (references_in_steps, "Session: is in use by steps"),
    (steps_in_run, "Session: is in use by run"),
]


@pytest.mark.parametrize(("misuse", "message"), OUT_OF_ORDER)
def test_a_session_names_the_call_that_is_out_of_order(ready, misuse, message):
    with pytest.raises(InputError, match=message):
        misuse(ready)


@pytest.mark.parametrize(
    "misuse", [send_first, lambda session: session.run(gentle(), time_limit=1.0)]
)
def test_a_session_needs_references(session, misuse):
    with pytest.raises(InputError, match=r"Session: has no references: call take_references\(\)"):
        misuse(session)


# an error must not leave the session reserved; `observe` without `send` keeps the last command
def test_a_session_continues_after_misuse(ready):
    with pytest.raises(InputError, match=NO_OBSERVATION):
        send_first(ready)
    with ready.steps() as steps:
        first = steps.observe()
        second = steps.observe()
        assert second.time == pytest.approx(first.time + ready.rig.period)
        assert second.command.opening == first.command.opening


@pytest.fixture(scope="module")
def bound():
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip")
    mount = mjtactile.attach(spec, "dense", site="tip")
    model = spec.compile()
    data = mujoco.MjData(model)
    return model, data, mount.bind(model, data)


@pytest.mark.parametrize("calls", [("after_step",), ("before_step", "before_step")])
def test_a_finger_is_stepped_in_order(bound, calls):
    model, data, finger = bound
    finger.reset()
    with pytest.raises(InputError, match="finger 'tactile': needs before_step"):
        for call in calls:
            getattr(finger, call)()
    finger.reset()
    mjtactile.step(model, data, [finger])


def test_a_pipeline_needs_references():
    pipeline = mjtactile.StatefulPipeline.of(mjtactile.load_sensor("dense"))
    image = mjtactile.Image(np.zeros((480, 640), np.uint8))
    with pytest.raises(mjtactile.DeviceError, match="before the flat and rest references"):
        pipeline.perceive(image, 0.0)
    with pytest.raises(InputError, match="shape: touches: is empty"):
        pipeline.shape([])


def test_a_closed_recorder_does_not_write(tmp_path):
    with mjtactile.Recorder(tmp_path / "run", {}) as recorder:
        recorder.note(first=1)
    recorder.note(second=2)
    recorder.close()
    text = (tmp_path / "run" / "log.jsonl").read_text()
    assert "first" in text
    assert "second" not in text
